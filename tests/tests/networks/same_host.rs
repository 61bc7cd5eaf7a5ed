//! Nodes without privileges on the switch's own host, and one node on another host:
//!
//! ```text
//!  near ─┐        ┌ gdp…h ═ gdp…s ┐
//!        ├─ IP ───┤                ├─ XDP ─ l0 ──── e0 remote
//!  next ─┘        └ lo ── daemon ──┘
//! ```

use std::time::Duration;

use anyhow::{Context, Result, ensure};
use gdp::unstable::{Node, NodeConfig, Publisher, Subscription};
use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Grantee, ReadGrant, issue};
use gdp_core::identity::{Identity, SigningKey};
use gdp_e2e::seal::Encoding;
use gdp_tests::netns::{Namespace, execute};
use gdp_tests::programs::Program;
use gdp_tests::wait::{TIMEOUT, wait_for};
use serde_json::Value;

use crate::inside::{Inside, ROOT};
use crate::lone_switch::LoneSwitch;
use crate::patient::patient;

/// A user without privileges or files.
const NOBODY: libc::uid_t = 65534;

#[test]
fn frames_of_nodes_beside_their_switch_do_not_meet_its_daemon() -> Result<()> {
    let site = LoneSwitch::build("xdp")?;
    let near = Party::connect(&site.host, NOBODY, "udp://127.0.0.1:31415")?;
    let next = Party::connect(&site.host, NOBODY, "udp://10.9.0.1:31415")?;
    let remote = Party::connect(&site.remote, ROOT, "eth://e0")?;
    let mut ways = [Way::open(&near, &next)?, Way::open(&next, &remote)?, Way::open(&remote, &near)?];
    for way in &mut ways {
        // The first large message may be lost: the node learns the path's MTU from it.
        wait_for("a first message", TIMEOUT, || Ok(way.may_carry(&vec![7; 1 << 16]).then_some(())))?;
    }
    let before = site.status()?;
    for i in 0..100u32 {
        for way in &mut ways {
            ensure!(way.carries(&i.to_be_bytes()), "message {i} was lost");
        }
    }
    for way in &mut ways {
        ensure!(way.carries(&vec![8; 1 << 16]), "a large message was lost");
    }
    let after = site.status()?;
    let more = |plane: &str, counter: &str| {
        let count = |status: &Value| status["counters_by_plane"][counter][plane].as_u64().unwrap_or(0);
        count(&after) - count(&before)
    };
    ensure!(more("kernel", "delivered") > 3 * 100 + 3 * 40, "{}", after["counters_by_plane"]);
    for counter in ["delivered", "forwarded", "replicated", "redirect_failed"] {
        ensure!(more("userspace", counter) == 0, "{counter}: {}", after["counters_by_plane"]);
    }
    let addresses = after["links"].to_string();
    ensure!(addresses.matches("udp:169.254.31.").count() == 2, "{addresses}");
    Ok(())
}

/// Here the frames are for an interface that accepts no redirected frames.
#[test]
fn what_the_kernel_leaves_to_the_daemon_arrives_there() -> Result<()> {
    let site = LoneSwitch::build("xdp")?;
    execute(site.remote.command(Program::Ethtool)?.args(["-K", "e0", "gro", "off"]))?;
    let near = Party::connect(&site.host, NOBODY, "udp://127.0.0.1:31415")?;
    let remote = Party::connect(&site.remote, ROOT, "eth://e0")?;
    let mut way = Way::open(&near, &remote)?;
    wait_for("a message by the slow path", TIMEOUT, || {
        let carried = way.may_carry(b"slowly");
        let counters = site.status()?["counters_by_plane"].take();
        let count = |counter: &str, plane: &str| counters[counter][plane].as_u64().unwrap_or(0);
        Ok((carried && count("slow", "kernel") > 0 && count("delivered", "userspace") > 0).then_some(()))
    })
    .with_context(|| site.report())
}

#[test]
fn copies_for_readers_beside_the_switch_and_elsewhere_are_made_in_the_kernel() -> Result<()> {
    let site = LoneSwitch::build("xdp")?;
    let writer = Party::connect(&site.host, NOBODY, "udp://127.0.0.1:31415")?;
    let readers = [
        Party::connect(&site.host, NOBODY, "udp://127.0.0.1:31415")?,
        Party::connect(&site.host, NOBODY, "udp://127.0.0.1:31415")?,
        Party::connect(&site.remote, ROOT, "eth://e0")?,
    ];
    let topic = Topic::new()?;
    let mut subscriptions = [topic.read(&readers[0])?, topic.read(&readers[1])?, topic.read(&readers[2])?];
    let mut publisher = topic.write(&writer)?;
    let mut all_hear = |message: &[u8], limit: Duration| -> Result<bool> {
        writer.inside.runtime.block_on(publisher.send(Encoding::Bytes, message))?;
        Ok(readers.iter().zip(&mut subscriptions).all(|(reader, heard)| reader.hears(heard, message, limit)))
    };
    let first = Duration::from_secs(1);
    wait_for("all readers to hear", TIMEOUT, || Ok(all_hear(b"first", first)?.then_some(())))
        .with_context(|| site.report())?;
    let replicated = |plane: &str| -> Result<u64> {
        Ok(site.status()?["counters_by_plane"]["replicated"][plane].as_u64().unwrap_or(0))
    };
    let before = (replicated("kernel")?, replicated("userspace")?);
    for i in 0..100u32 {
        ensure!(all_hear(&i.to_be_bytes(), TIMEOUT)?, "message {i} was lost; {}", site.report());
    }
    let after = (replicated("kernel")?, replicated("userspace")?);
    ensure!(after.0 >= before.0 + 100 && after.1 == before.1, "{before:?}, then {after:?}: {}", site.report());
    Ok(())
}

#[test]
fn a_daemon_that_is_killed_and_replaced_loses_no_message_of_nodes_beside_it() -> Result<()> {
    let mut site = LoneSwitch::build("xdp")?;
    let near = Party::connect(&site.host, NOBODY, "udp://127.0.0.1:31415")?;
    let next = Party::connect(&site.host, NOBODY, "udp://127.0.0.1:31415")?;
    let mut way = Way::open(&near, &next)?;
    wait_for("a first message", TIMEOUT, || Ok(way.may_carry(b"first").then_some(())))?;
    let ends = site.ends()?;
    ensure!(ends.len() == 2, "{ends:?}");
    site.daemon.kill()?;
    ensure!(site.ends()? == ends, "a crash leaves the pair");
    for i in 0..200u32 {
        ensure!(way.carries(&i.to_be_bytes()), "message {i} was lost without a daemon");
    }
    site.start()?;
    let mut i = 0u32;
    let back = |party: &Party| party.node.counters().links == 2 && party.node.switch().is_ok();
    wait_for("both nodes to have made their links anew", 2 * TIMEOUT, || {
        for _ in 0..20 {
            i += 1;
            ensure!(way.carries(&i.to_be_bytes()), "message {i} was lost with the new daemon");
        }
        Ok((back(&near) && back(&next)).then_some(()))
    })
    .with_context(|| site.report())?;
    for i in 0..200u32 {
        ensure!(way.carries(&i.to_be_bytes()), "message {i} was lost on the new links");
    }
    ensure!(site.ends()? == ends, "the pair is the one that was there");
    let status = site.status()?;
    ensure!(status["links"].to_string().matches("udp:169.254.31.").count() == 2, "{}", status["links"]);
    Ok(())
}

#[test]
fn the_pair_goes_with_the_daemon_that_is_stopped_or_cleared_away() -> Result<()> {
    let mut site = LoneSwitch::build("xdp")?;
    ensure!(site.ends()?.len() == 2);
    site.daemon.stop(TIMEOUT)?;
    ensure!(site.ends()?.is_empty(), "a stop removes it");
    site.start()?;
    site.daemon.kill()?;
    ensure!(site.ends()?.len() == 2, "a crash does not");
    let mut detach = site.host.command(site.tools.gdp_ctl()?)?;
    let detached = execute(detach.args(["xdp", "detach", "-j", "--bpffs"]).arg(site.bpffs()))?;
    ensure!(site.ends()?.is_empty(), "{detached}");
    Ok(())
}

#[test]
fn without_xdp_or_the_pair_frames_go_through_the_daemon() -> Result<()> {
    for plane in ["userspace", "xdp"] {
        let site = LoneSwitch::build(plane)?;
        let near = Party::connect(&site.host, NOBODY, "udp://127.0.0.1:31415")?;
        let next = Party::connect(&site.host, NOBODY, "udp://127.0.0.1:31415")?;
        let mut way = Way::open(&near, &next)?;
        wait_for("a first message", TIMEOUT, || Ok(way.may_carry(b"first").then_some(())))?;
        match site.ends()?.first() {
            None => ensure!(plane == "userspace"),
            Some(end) => drop(site.host.ip(&["link", "del", end])?),
        }
        let delivered = |status: Value| status["counters_by_plane"]["delivered"]["userspace"].as_u64().unwrap_or(0);
        let before = delivered(site.status()?);
        wait_for("messages through the daemon", TIMEOUT, || {
            let carried = way.may_carry(b"again");
            Ok((carried && delivered(site.status()?) > before).then_some(()))
        })
        .with_context(|| site.report())?;
    }
    Ok(())
}

/// Blocked as by a packet filter.
#[test]
fn a_pair_that_is_blocked_is_not_used() -> Result<()> {
    let site = LoneSwitch::build("xdp")?;
    let neighbours: Value = serde_json::from_str(&site.host.ip(&["-j", "neigh", "show", "nud", "permanent"])?)?;
    let switch = neighbours[0]["dst"].as_str().context("the switch's address on the pair")?;
    site.host.ip(&["route", "replace", "blackhole", switch])?;
    let near = Party::connect(&site.host, NOBODY, "udp://127.0.0.1:31415")?;
    let next = Party::connect(&site.host, NOBODY, "udp://127.0.0.1:31415")?;
    let mut way = Way::open(&near, &next)?;
    wait_for("a message", TIMEOUT, || Ok(way.may_carry(b"by the daemon").then_some(())))?;
    let links = site.status()?["links"].to_string();
    ensure!(links.matches("udp:127.0.0.1:").count() == 2, "{links}");
    Ok(())
}

/// A node in a namespace.
struct Party {
    node: Node,
    identity: Identity,
    inside: Inside,
}

impl Party {
    fn connect(at: &Namespace, user: libc::uid_t, to: &str) -> Result<Self> {
        let (inside, identity) = (Inside::new(at, user)?, Identity::generate("proxy")?);
        let node = inside.run(Node::connect(NodeConfig::new(identity.clone(), to.parse()?)))??;
        Ok(Self { node, identity, inside })
    }

    /// Returns whether this message arrives within a time. Late copies of earlier messages may
    /// arrive first.
    fn hears(&self, subscription: &mut Subscription, wanted: &[u8], limit: Duration) -> bool {
        let next = async {
            while let Some(message) = subscription.recv().await {
                if message.body == wanted {
                    return true;
                }
            }
            false
        };
        let within = async { tokio::time::timeout(limit, next).await };
        self.inside.runtime.block_on(within).unwrap_or(false)
    }
}

struct Topic {
    owner: SigningKey,
    card: NameCard,
}

impl Topic {
    fn new() -> Result<Self> {
        let owner = SigningKey::generate()?;
        let card = NameCard::create(owner.verify_key(), "topic", "/chatter", "T", None)?;
        Ok(Self { owner, card })
    }

    fn read(&self, party: &Party) -> Result<Subscription> {
        let (name, to) = (self.card.name(), Grantee::Entity(party.identity.name()));
        let grant = ReadGrant { name, to, serial: 1, not_before: 0, not_after: 4_000_000_000 };
        let grant = issue(&self.owner, &grant)?.into();
        let subscribe = party.node.subscribe(self.card.proof(), grant, patient().1);
        Ok(party.inside.runtime.block_on(subscribe)?)
    }

    fn write(&self, party: &Party) -> Result<Publisher> {
        let (name, entity) = (self.card.name(), party.identity.name());
        let (scope, serial, not_before, not_after) = (vec![], 1, 0, 4_000_000_000);
        let cert = issue(&self.owner, &AdCert { name, entity, scope, serial, not_before, not_after })?.into();
        let publish = party.node.publish(self.card.proof(), cert, patient().0);
        Ok(party.inside.runtime.block_on(publish)?)
    }
}

/// A topic with one writer and one reader.
struct Way<'a> {
    from: &'a Party,
    to: &'a Party,
    publisher: Publisher,
    subscription: Subscription,
}

impl<'a> Way<'a> {
    fn open(from: &'a Party, to: &'a Party) -> Result<Self> {
        let topic = Topic::new()?;
        let subscription = topic.read(to)?;
        Ok(Self { from, to, publisher: topic.write(from)?, subscription })
    }

    /// Returns whether a message arrives.
    fn carries(&mut self, body: &[u8]) -> bool {
        self.carries_within(body, TIMEOUT)
    }

    /// Returns whether a message that may be lost arrives, after a shorter wait.
    fn may_carry(&mut self, body: &[u8]) -> bool {
        self.carries_within(body, Duration::from_secs(1))
    }

    fn carries_within(&mut self, body: &[u8], limit: Duration) -> bool {
        let sent = self.from.inside.runtime.block_on(self.publisher.send(Encoding::Bytes, body));
        sent.is_ok() && self.to.hears(&mut self.subscription, body, limit)
    }
}
