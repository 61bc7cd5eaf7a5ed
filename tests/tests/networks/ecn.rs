//! Congestion marks of a router on the path reach the reader, over any kind of link before and
//! behind the router. The reader reports the marks, and the writer slows down.
//!
//! ```text
//!   robot:r0 ──── l0:s1:r0 ──── l0:s2:r0 ──── l0:cloud
//!    writer        switch        switch        reader
//! ```
//!
//! Each cable carries Ethernet, or has IP addresses and UDP. One cable is slow and marks queued IP
//! packets; or the first switch has a slow interface.

use std::time::Duration;

use anyhow::{Context, Result, ensure};
use gdp::unstable::{Node, NodeConfig, PublishOptions, SubscribeOptions};
use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Grantee, ReadGrant, issue};
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::link_target::LinkTarget;
use gdp_daemon::config::{Config, DataPlane, Neighbour, NeighbourAddress, Via};
use gdp_daemon::serve::{Running, start};
use gdp_e2e::seal::Encoding;
use gdp_e2e::transport::TopicCounters;
use gdp_faults::Faults;
use gdp_tests::Tools;
use gdp_tests::chain::{Chain, ChainOptions};
use gdp_tests::netns::{Namespace, execute};
use gdp_tests::programs::Program;
use gdp_tests::wait::{TIMEOUT, wait_for};
use gdp_tests::wire::Wire;
use serde_json::Value;

use crate::inside::{Inside, ROOT};

const SEED: u64 = 9;

const ETHERNET: Cable = Cable::Ethernet;
const V4: Cable = Cable::V4;
const V6: Cable = Cable::V6;

#[test]
fn a_mark_on_ipv4_goes_on_over_ethernet() -> Result<()> {
    marks_arrive([ETHERNET, V4, ETHERNET], 1, DataPlane::Xdp)
}

#[test]
fn a_mark_on_ipv6_goes_on_over_ethernet() -> Result<()> {
    marks_arrive([ETHERNET, V6, ETHERNET], 1, DataPlane::Xdp)
}

#[test]
fn a_mark_goes_on_over_two_switches_and_in_other_datagrams() -> Result<()> {
    marks_arrive([V4, V6, V4], 0, DataPlane::Xdp)?;
    marks_arrive([V6, ETHERNET, ETHERNET], 0, DataPlane::Xdp)
}

#[test]
fn a_mark_behind_the_last_switch_is_seen_as_well() -> Result<()> {
    marks_arrive([ETHERNET, ETHERNET, V4], 2, DataPlane::Xdp)?;
    marks_arrive([V4, ETHERNET, V6], 2, DataPlane::Xdp)
}

#[test]
fn the_userspace_plane_carries_marks_on_too() -> Result<()> {
    marks_arrive([ETHERNET, V4, ETHERNET], 1, DataPlane::Userspace)?;
    marks_arrive([V6, V4, V6], 0, DataPlane::Userspace)
}

#[test]
fn nobody_speaks_of_congestion_where_nothing_is_marked() -> Result<()> {
    let site = Site::build([V4, ETHERNET, V6], Some(1), DataPlane::Xdp)?;
    let (told, wire) = (site.carry_messages(true)?, site.marked());
    ensure!(wire > 0, "packets waited");
    // There is no IP on that cable, and the hop tag covers the frame's own header.
    ensure!(told.marked == 0, "{told:?}");
    Ok(())
}

/// A userspace switch marks frames that queue for an Ethernet interface, where no router can.
#[test]
fn the_userspace_plane_marks_what_waits() -> Result<()> {
    let site = Site::build([ETHERNET; 3], None, DataPlane::Userspace)?;
    let command = "qdisc add dev r0 root tbf rate 100mbit burst 10kb limit 8mb";
    execute(site.chain.switches()[0].command(Program::Tc)?.args(command.split(' ')))?;
    let told = site.carry_messages(false)?;
    ensure!(told.marked > 0 && told.slowed > 0, "{told:?}");
    Ok(())
}

fn marks_arrive(cables: [Cable; 3], slow: usize, data_plane: DataPlane) -> Result<()> {
    let context = || format!("{cables:?}, the cable {slow} is slow, {data_plane:?}");
    let site = Site::build(cables, Some(slow), data_plane)?;
    let (told, wire) = (site.carry_messages(false).with_context(context)?, site.marked());
    // The other marks are on QUIC packets.
    let most = (wire / 2 + 1)..=wire;
    ensure!(wire > 0 && most.contains(&told.marked), "{}: {wire} marks, {told:?}", context());
    ensure!(told.slowed > 0, "{}: {told:?}", context());
    Ok(())
}

/// The medium of a link between neighbours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Cable {
    Ethernet,
    V4,
    V6,
}

impl Cable {
    /// Returns the address of an end, 1 or 2.
    fn address(self, cable: usize, end: usize) -> String {
        match self {
            Self::V6 => format!("2001:db8:{cable}::{end}"),
            _ => format!("10.9.{cable}.{end}"),
        }
    }

    /// Returns how the node at one end reaches the switch at the other.
    fn via(self, cable: usize, end: usize) -> Result<Via> {
        Ok(match self {
            Self::Ethernet => Via::Interface(interface(end).into()),
            _ => Via::Udp((self.address(cable, 3 - end).parse::<std::net::IpAddr>()?, 31415).into()),
        })
    }

    fn target(self, cable: usize, end: usize) -> Result<LinkTarget> {
        Ok(match self.via(cable, end)? {
            Via::Interface(name) => format!("eth://{name}").parse()?,
            Via::Udp(address) => format!("udp://{address}").parse()?,
            Via::Tls(target) => target,
        })
    }
}

/// Returns the interface of the node at this end of a cable: 1 is the robot's side.
fn interface(end: usize) -> &'static str {
    if end == 1 { "r0" } else { "l0" }
}

struct Site {
    // Fields drop in this order.
    switches: Vec<(Running, Inside)>,
    wire: Option<Wire>,
    chain: Chain,
    cables: [Cable; 3],
    data_plane: DataPlane,
    files: tempfile::TempDir,
}

impl Site {
    /// Builds the network. `slow`: the index of the slow cable.
    fn build(cables: [Cable; 3], slow: Option<usize>, data_plane: DataPlane) -> Result<Self> {
        let chain = Chain::build(ChainOptions { switches: 2, wire: slow, ..Default::default() })?;
        chain.nodes().iter().try_for_each(Namespace::enable_ipv6)?;
        for (number, cable) in cables.into_iter().enumerate().filter(|(_, cable)| *cable != ETHERNET) {
            let length = if cable == V6 { 64 } else { 24 };
            for (end, node) in [(1, &chain.nodes()[number]), (2, &chain.nodes()[number + 1])] {
                let address = format!("{}/{length}", cable.address(number, end));
                let flags: &[&str] = if cable == V6 { &["nodad"] } else { &[] };
                node.ip(&[&["addr", "add", &address, "dev", interface(end)], flags].concat())?;
            }
        }
        let files = tempfile::tempdir()?;
        let mut site = Self { switches: vec![], wire: None, chain, cables, data_plane, files };
        for i in [0, 1] {
            let inside = Inside::new(&site.chain.switches()[i], ROOT)?;
            let running = inside.run(start(site.config(i)?))??;
            site.switches.push((running, inside));
        }
        wait_for("the switches to be neighbours", TIMEOUT, || {
            let linked = |i| site.status(i)["links"].as_array().is_some_and(|links| links.len() == 1);
            Ok((linked(0) && linked(1)).then_some(()))
        })?;
        if slow.is_some() {
            let slow = Faults { rate: Some(40_000_000), mark_above: Some(6_000), ..Faults::default() };
            site.wire = Some(site.chain.disturb_wire([slow, Faults::default()], SEED)?);
        }
        Ok(site)
    }

    /// Returns the number of frames that the slow cable marked.
    fn marked(&self) -> u64 {
        self.wire.as_ref().map_or(0, |wire| wire.counts(0).marked)
    }

    fn config(&self, i: usize) -> Result<Config> {
        let folder = self.files.path();
        let identity = |i: usize| folder.join(format!("s{i}.pem"));
        let near = NeighbourAddress {
            switch: Identity::load_or_generate(&identity(1 - i), "switch")?.name(),
            via: self.cables[1].via(1, i + 1)?,
        };
        let ends = [(self.cables[i], 2), (self.cables[i + 1], 1)];
        let on_ethernet = ends.into_iter().filter(|(cable, _)| *cable == ETHERNET);
        Ok(Config {
            identity: identity(i),
            socket: folder.join(format!("s{i}.sock")),
            all_interfaces: false,
            keep: false,
            interfaces: Some(on_ethernet.map(|(_, end)| interface(end).into()).collect()),
            udp: ends.iter().any(|(cable, _)| *cable != ETHERNET).then_some("[::]:31415".parse()?),
            tls: None,
            data_plane: self.data_plane,
            dpdk: Default::default(),
            rib: i == 1,
            neighbours: vec![Neighbour { address: near, cost: None, dial: false, parent: false, tls: None }],
            ebpf_object: Some(Tools::beside_this_test()?.ebpf_object()?),
            fib_capacity: 1024,
            bpffs: None,
            domain: None,
            public: Vec::new(),
            etcd: None,
            metrics: None,
            metrics_token: None,
            crypto: None,
            rekey: Default::default(),
        })
    }

    fn status(&self, i: usize) -> Value {
        let (running, inside) = &self.switches[i];
        inside.runtime.block_on(running.status())
    }

    /// Sends messages from the robot to the cloud as fast as possible, and returns the writer's
    /// counters. `silent`: no reports of marks are expected.
    fn carry_messages(&self, silent: bool) -> Result<TopicCounters> {
        const REPORTED: Duration = Duration::from_secs(2);
        const ROUNDS: usize = 5;
        const MESSAGES: usize = 100;
        const LENGTH: usize = 40_000;
        let owner = SigningKey::generate()?;
        let card = NameCard::create(owner.verify_key(), "topic", "/camera", "T", None)?;
        let (robot, cloud) = (Identity::generate("proxy")?, Identity::generate("proxy")?);
        let (name, serial, not_before, not_after) = (card.name(), 1, 0, 4_000_000_000);
        let (to, entity) = (Grantee::Entity(cloud.name()), robot.name());
        let grant = issue(&owner, &ReadGrant { name, to, serial, not_before, not_after })?.into();
        let cert = AdCert { name, entity, scope: vec![], serial, not_before, not_after };
        let cert = issue(&owner, &cert)?.into();

        let [first, _, last] = self.cables;
        let reader = Inside::new(self.chain.cloud(), ROOT)?;
        let reading = reader.run(Node::connect(NodeConfig::new(cloud, last.target(2, 2)?)))??;
        let subscribe = reading.subscribe(card.proof(), grant, SubscribeOptions::reliable());
        let mut subscription = reader.runtime.block_on(subscribe)?;
        let writer = Inside::new(self.chain.robot(), ROOT)?;
        let writing = writer.run(Node::connect(NodeConfig::new(robot, first.target(0, 1)?)))??;
        let mut publisher = writer.runtime.block_on(writing.publish(card.proof(), cert, PublishOptions::reliable()))?;
        let before = [0, 1].map(|i| self.onward(i));

        let mut told = publisher.counters().topic;
        for _ in 0..ROUNDS {
            let received = reader.runtime.spawn(async move {
                for i in 0..MESSAGES {
                    let next = tokio::time::timeout(TIMEOUT, subscription.recv()).await;
                    let message = next.context("not received")?.context("a live subscription")?;
                    ensure!(*message.body == [i as u8; LENGTH], "another message");
                }
                Ok(subscription)
            });
            for i in 0..MESSAGES {
                writer.runtime.block_on(publisher.send(Encoding::Bytes, &[i as u8; LENGTH]))?;
            }
            subscription = reader.runtime.block_on(received)??;
            // The reader's last report follows the last message. A loss at the beginning slows the
            // writer down; for a while there may be nothing to mark.
            let reported = wait_for("reports of the marks", REPORTED, || {
                told = publisher.counters().topic;
                Ok((told.marked > self.marked() / 2 && told.slowed > 0).then_some(()))
            });
            if reported.is_ok() || silent && self.marked() > 0 {
                break;
            }
        }
        self.wire.iter().try_for_each(Wire::check)?;

        for (i, before) in before.into_iter().enumerate() {
            let [before, after] = [before, self.onward(i)];
            let [kernel, userspace] = [0, 1].map(|plane| after[plane] - before[plane]);
            let [most, few] = if self.data_plane == DataPlane::Xdp { [kernel, userspace] } else { [userspace, kernel] };
            ensure!(most > 2500 && few < 50, "{}", self.status(i)["counters_by_plane"]);
            for reason in ["drop_bad_tag", "drop_congested"] {
                let dropped = &self.status(i)["counters"][reason];
                ensure!(dropped.as_u64().unwrap_or(0) == 0, "{reason}: {dropped}");
            }
        }
        writer.runtime.block_on(writing.close());
        reader.runtime.block_on(reading.close());
        Ok(told)
    }

    /// Returns the frames that a switch forwarded, in the kernel and in userspace.
    fn onward(&self, i: usize) -> [u64; 2] {
        let status = self.status(i);
        let count = |counter: &str, plane: &str| status["counters_by_plane"][counter][plane].as_u64().unwrap_or(0);
        ["kernel", "userspace"].map(|plane| count("forwarded", plane) + count("delivered", plane))
    }
}

impl Drop for Site {
    fn drop(&mut self) {
        for (running, inside) in self.switches.drain(..) {
            inside.runtime.block_on(running.stop());
        }
    }
}
