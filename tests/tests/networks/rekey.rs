//! Link keys that are replaced many times a minute under traffic, in both data planes. No frame is
//! lost, and frames recorded under a retired key are refused.
//!
//! ```text
//!  robot r0 ── l0 s1 r0 ══ wire ══ l0 s2 r0 ── l0 cloud        s2 is the RIB
//! ```
//!
//! Daemons and nodes run in this process, because their rekey interval is not configurable.

use std::time::{Duration, Instant, SystemTime};

use anyhow::{Context, Result, ensure};
use gdp::unstable::{Node, NodeConfig, Publisher, Subscription};
use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Grantee, ReadGrant, issue};
use gdp_core::identity::{Identity, SigningKey};
use gdp_daemon::config::{Config, DataPlane, Neighbour, NeighbourAddress, Via};
use gdp_daemon::serve::{Running, start};
use gdp_e2e::seal::Encoding;
use gdp_link::link::RekeySchedule;
use gdp_tests::Tools;
use gdp_tests::chain::{Chain, ChainOptions};
use gdp_tests::packet::is_gdp_data;
use gdp_tests::wait::TIMEOUT;
use gdp_wire::Name;
use serde_json::Value;

use crate::inside::{Inside, ROOT};
use crate::patient::patient;

/// The overlap is far longer than a busy machine delays a thread between tagging and sending.
const OFTEN: RekeySchedule =
    RekeySchedule { interval: Duration::from_millis(100), frames: u64::MAX, overlap: Duration::from_millis(500) };

/// Least number of changes of every key.
const CHANGES: u64 = 8;

/// Least number of messages in each direction; each has several frames.
const MESSAGES: u32 = 500;

const BODY: usize = 5000;

#[test]
fn keys_change_without_loss_in_the_kernel() -> Result<()> {
    Scene::set(DataPlane::Xdp)?.keys_change_without_loss("kernel")
}

#[test]
fn keys_change_without_loss_in_userspace() -> Result<()> {
    Scene::set(DataPlane::Userspace)?.keys_change_without_loss("userspace")
}

/// Fields drop in this order.
struct Scene {
    there: Way,
    back: Way,
    nodes: Vec<(Node, Inside)>,
    switches: Vec<(Running, Inside)>,
    chain: Chain,
    _files: tempfile::TempDir,
}

/// A name from one end to the other.
struct Way {
    publisher: Publisher,
    subscription: Subscription,
}

impl Scene {
    fn set(data_plane: DataPlane) -> Result<Self> {
        let tools = Tools::beside_this_test()?;
        let chain = Chain::build(ChainOptions { switches: 2, wire: Some(1), ..Default::default() })?;
        let files = tempfile::tempdir()?;
        let names = [1, 2].map(|i| Identity::load_or_generate(&files.path().join(format!("s{i}.pem")), "switch"));
        let names = names.into_iter().map(|identity| Ok(identity?.name())).collect::<Result<Vec<_>>>()?;
        let mut switches = Vec::new();
        for (i, (interface, other)) in [("r0", 1), ("l0", 0)].into_iter().enumerate() {
            let place = NeighbourAddress { switch: names[other], via: Via::Interface(interface.into()) };
            let config = Config {
                identity: files.path().join(format!("s{}.pem", i + 1)),
                socket: files.path().join(format!("s{}.sock", i + 1)),
                all_interfaces: false,
                keep: false,
                interfaces: Some(vec!["l0".into(), "r0".into()]),
                udp: None,
                tls: None,
                data_plane,
                dpdk: Default::default(),
                rib: i == 1,
                neighbours: vec![Neighbour { address: place, cost: None, dial: false, parent: false, tls: None }],
                ebpf_object: Some(tools.ebpf_object()?),
                fib_capacity: 1024,
                bpffs: None,
                domain: None,
                public: Vec::new(),
                etcd: None,
                metrics: None,
                metrics_token: None,
                crypto: None,
                rekey: OFTEN,
            };
            let inside = Inside::new(&chain.switches()[i], ROOT)?;
            let running = inside.run(start(config))??;
            switches.push((running, inside));
        }
        let mut nodes = Vec::new();
        let identities = [Identity::generate("proxy")?, Identity::generate("proxy")?];
        for (identity, (namespace, interface)) in identities.iter().zip([(chain.robot(), "r0"), (chain.cloud(), "l0")])
        {
            let mut config = NodeConfig::new(identity.clone(), format!("eth://{interface}").parse()?);
            (config.rekey, config.connect_timeout) = (OFTEN, TIMEOUT);
            let inside = Inside::new(namespace, ROOT)?;
            let node = inside.run(Node::connect(config))??;
            nodes.push((node, inside));
        }
        let there = Way::open(&nodes[0], &nodes[1])?;
        let back = Way::open(&nodes[1], &nodes[0])?;
        Ok(Self { there, back, nodes, switches, chain, _files: files })
    }

    fn keys_change_without_loss(mut self, plane: &str) -> Result<()> {
        let wire = self.chain.wire_from_robot()?;
        let (mut messages, begin) = (0, Instant::now());
        // A node's first greeting may arrive before a switch has its route; the node repeats it.
        let (mut recorded, mut lost_before) = (None, Vec::new());
        loop {
            for way in [&mut self.there, &mut self.back] {
                way.cross(messages, &self.switches[0].1)?;
            }
            if recorded.is_none() {
                recorded = Some(wire.receive(TIMEOUT, is_gdp_data)?);
                lost_before = self.lost()?;
            }
            messages += 1;
            let changes = self.fewest_changes()?;
            ensure!(begin.elapsed() < 4 * TIMEOUT, "only {changes} changes of some key");
            if messages >= MESSAGES && changes >= CHANGES {
                break;
            }
        }
        ensure!(self.lost()? == lost_before, "{lost_before:?}, and then {:?}", self.lost()?);
        self.every_message_arrived(messages.into())?;

        let recorded = recorded.context("there were messages")?;
        let wire = self.chain.wire_to_cloud()?;
        (0..20).try_for_each(|_| wire.send(&recorded))?;
        let deadline = Instant::now() + TIMEOUT;
        let mut refused = 0;
        while refused < 20 {
            ensure!(Instant::now() < deadline, "{refused} of 20 recorded frames were refused: {}", self.status(1));
            refused = self.status(1)["counters_by_plane"]["drop_bad_tag"][plane].as_u64().unwrap_or(0);
        }
        ensure!(refused == 20, "{refused}");
        self.end();
        Ok(())
    }

    /// Returns the number of replacements of the least replaced key.
    fn fewest_changes(&self) -> Result<u64> {
        let mut fewest = u64::MAX;
        for i in 0..2 {
            let status = self.status(i);
            let links = status["links"].as_array().context("links")?;
            ensure!(links.len() == 2, "{status}");
            for way in ["rx", "tx"] {
                let of = |link: &Value| link["key_generations"][way].as_u64().unwrap_or(0);
                fewest = links.iter().map(of).fold(fewest, u64::min);
            }
        }
        Ok(fewest)
    }

    /// Returns the switches' drops by reason.
    fn lost(&self) -> Result<Vec<(usize, String, u64)>> {
        let mut lost = Vec::new();
        for i in 0..2 {
            let status = self.status(i);
            let counters = status["counters"].as_object().context("counters")?;
            let dropped = counters.iter().filter(|(name, count)| name.starts_with("drop_") && **count != 0);
            lost.extend(dropped.map(|(name, count)| (i, name.clone(), count.as_u64().unwrap_or(0))));
        }
        Ok(lost)
    }

    fn every_message_arrived(&self, messages: u64) -> Result<()> {
        let [robot, cloud] = [0, 1].map(|i: usize| self.nodes[i].0.counters());
        for (from, to) in [(&robot, &cloud), (&cloud, &robot)] {
            ensure!(from.messages_sent == messages && to.messages_received == messages, "{from:?} {to:?}");
            ensure!(to.frames_received > 2 * messages, "{from:?} {to:?}");
            // A delayed and repeated message arrives twice. The other end's first feedback may
            // arrive before this end knows it.
            let harmless = ["seal_duplicate", "drop_feedback_unknown"];
            ensure!(to.drops.keys().all(|reason| harmless.contains(reason)), "{to:?}");
        }
        Ok(())
    }

    fn status(&self, i: usize) -> Value {
        let (running, inside) = &self.switches[i];
        inside.runtime.block_on(running.status())
    }

    fn end(self) {
        drop((self.there, self.back));
        for (node, inside) in self.nodes {
            inside.runtime.block_on(node.close());
        }
        for (running, inside) in self.switches {
            inside.runtime.block_on(running.stop());
        }
    }
}

impl Way {
    fn open((writer, at_writer): &(Node, Inside), (reader, at_reader): &(Node, Inside)) -> Result<Self> {
        let owner = SigningKey::generate()?;
        let card = NameCard::create(owner.verify_key(), "topic", "/chatter", "T", None)?;
        let not_after = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH)?.as_secs() + 3600;
        let (name, not_before) = (card.name(), 0);
        let (to, serial) = (Grantee::Entity(reader.name()), 1);
        let grant = issue(&owner, &ReadGrant { name, to, serial, not_before, not_after })?.into();
        let entity: Name = writer.name();
        let cert = AdCert { name, entity, scope: vec![], serial, not_before, not_after };
        let cert = issue(&owner, &cert)?.into();
        let (publish, subscribe) = patient();
        let subscription = at_reader.runtime.block_on(reader.subscribe(card.proof(), grant, subscribe))?;
        let publisher = at_writer.runtime.block_on(writer.publish(card.proof(), cert, publish))?;
        Ok(Self { publisher, subscription })
    }

    /// Sends one message, which must arrive.
    fn cross(&mut self, number: u32, inside: &Inside) -> Result<()> {
        let mut body = vec![7; BODY];
        body[..4].copy_from_slice(&number.to_be_bytes());
        inside.runtime.block_on(async {
            self.publisher.send(Encoding::Bytes, &body).await?;
            let received = tokio::time::timeout(TIMEOUT, self.subscription.recv()).await;
            let message =
                received.with_context(|| format!("message {number} was lost"))?.context("a live subscription")?;
            ensure!(message.body[..] == body[..], "another message");
            Ok(())
        })
    }
}
