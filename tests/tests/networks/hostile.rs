//! An attacker on a cable replays, cuts, flips and invents frames. Another attacker has a key and a
//! link and sends what it may not. No such frame reaches ROS, and every one is counted under a drop
//! reason.

mod half_open;

use gdp_wire::hop;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use gdp_core::identity::Identity;
use gdp_link::link::Link;
use gdp_link::port::{InFrame, OutFrame, Port, PortConfig, RecvBatch};
use gdp_tests::Tools;
use gdp_tests::chain::ChainOptions;
use gdp_tests::fabric::{Fabric, FabricOptions};
use gdp_tests::packet::{ETHERNET, GDP_ETHERTYPE, PacketSocket, is_gdp_data};
use gdp_tests::peers::{self, Conversation, Received, Side, Traffic, Vendor};
use gdp_tests::wait::{TIMEOUT, wait_for};
use gdp_wire::replay::{self, Window};
use gdp_wire::table::PORT_USERSPACE;
use gdp_wire::{ErrorCode, Header, Name, forward};
use serde_json::Value;
use tokio::runtime::Runtime;
use zerocopy::{FromBytes, IntoBytes};

/// Bytes of the GDP header.
const HEADER: usize = 96;

/// Bytes of the header up to the source, which the hop tag does not cover.
const SOURCE: usize = 64;

/// Indices of the first switch of an attacker's frames: S2 between s1 and s2, S1 next to the robot.
const S2: usize = 1;
const S1: usize = 0;

struct Scene {
    fabric: Fabric,
    conversation: Conversation,
    attacker: PacketSocket,
    /// A captured data frame: Ethernet, header, sealed message.
    frame: Vec<u8>,
}

impl Scene {
    /// Builds a fabric with message traffic and captures one message.
    fn set() -> Result<Self> {
        let chain = ChainOptions { wire: Some(1), ..Default::default() };
        let mut fabric = Fabric::start(Tools::beside_this_test()?, FabricOptions { chain, ..Default::default() })?;
        fabric.start_proxies()?;
        let traffic = Traffic::default();
        let talks = Side { at: fabric.chain.robot(), vendor: Vendor::Cyclone, traffic: &traffic };
        let hears = Side { at: fabric.chain.cloud(), vendor: Vendor::FastDds, traffic: &traffic };
        let conversation = Conversation::start(&fabric.tools, talks, hears, fabric.folder())?;
        let eavesdropper = fabric.chain.wire_from_robot()?;
        conversation.open()?;
        let frame = eavesdropper.receive(TIMEOUT, is_gdp_data)?;
        let attacker = fabric.chain.wire_to_cloud()?;
        Ok(Self { fabric, conversation, attacker, frame })
    }

    /// Sends hostile frames and waits until s2 has counted all of them under `reason`.
    fn refused_by_s2(&self, reason: &str, frames: &[Vec<u8>]) -> Result<()> {
        // Fewer frames at a time than a veth's ring has room for.
        frames.chunks(64).try_for_each(|frames| {
            let before = self.fabric.counter(S2, reason)?;
            self.send(frames)?;
            self.wait_for_count(reason, before + frames.len() as u64, |fabric| fabric.counter(S2, reason))
        })
    }

    /// Cuts the cable and relays frames until `count` data frames have continued toward the cloud,
    /// each changed by `alter`.
    fn hand_on(&self, count: usize, mut alter: impl FnMut(usize, &mut Vec<u8>)) -> Result<()> {
        const TURN: Duration = Duration::from_millis(2);
        // Captures nothing that the cable has carried, which would be a replay.
        self.fabric.chain.cut_wire(true)?;
        let (from_robot, from_cloud) = (self.fabric.chain.wire_from_robot()?, &self.attacker);
        let (mut altered, deadline) = (0, Instant::now() + TIMEOUT);
        while altered < count {
            ensure!(Instant::now() < deadline, "only {altered} data frames came");
            if let Ok(mut frame) = from_robot.receive(TURN, is_gdp) {
                if is_gdp_data(&frame) {
                    alter(altered, &mut frame);
                    altered += 1;
                }
                from_cloud.send(&frame)?;
            }
            if let Ok(frame) = from_cloud.receive(TURN, is_gdp) {
                from_robot.send(&frame)?;
            }
        }
        self.fabric.chain.cut_wire(false)
    }

    fn send(&self, frames: &[Vec<u8>]) -> Result<()> {
        frames.iter().try_for_each(|frame| self.attacker.send(frame))
    }

    fn wait_for_count(&self, reason: &str, expected: u64, count: impl Fn(&Fabric) -> Result<u64>) -> Result<()> {
        let waited = wait_for(&format!("{reason} to reach {expected}"), TIMEOUT, || {
            Ok((count(&self.fabric)? >= expected).then_some(()))
        });
        waited.with_context(|| {
            let s2 = self.fabric.status(S2).unwrap_or_default();
            format!("s2: {}\ncloud: {}", s2["counters"], self.fabric.proxy_stats("cloud"))
        })
    }

    /// Checks that honest messages still arrive, and nothing else: every number once, in order,
    /// with its original content.
    fn only_honest_messages_arrived(self) -> Result<()> {
        let messages = self.no_dishonest_message_arrived()?;
        let numbers: Vec<i64> = messages.iter().map(|message| message.sequence).collect();
        ensure!(numbers == (0..numbers.len() as i64).collect::<Vec<_>>(), "not each once and in order: {numbers:?}");
        Ok(())
    }

    /// Checks that no other message arrived. Some honest messages may be missing.
    fn no_dishonest_message_arrived(mut self) -> Result<Vec<Received>> {
        let so_far = peers::received(&self.conversation.listener).len();
        let messages = self.conversation.listener.wait_until("ten more messages", TIMEOUT, |p| {
            Some(peers::received(p)).filter(|messages| messages.len() >= so_far + 10)
        });
        let stats = || format!("{}\n{}", self.fabric.proxy_stats("robot"), self.fabric.proxy_stats("cloud"));
        let messages = messages.with_context(stats)?;
        ensure!(messages.iter().all(|message| message.intact), "a damaged message reached ROS: {messages:?}");
        let ordered = messages.is_sorted_by(|a, b| a.sequence < b.sequence);
        ensure!(ordered, "not each at most once and in order: {messages:?}");
        Ok(messages)
    }

    fn flipped(&self, bit: usize) -> Vec<u8> {
        let mut frame = self.frame.clone();
        frame[ETHERNET + bit / 8] ^= 1 << (bit % 8);
        frame
    }
}

#[test]
fn replayed_frames_are_refused_by_the_next_switch() -> Result<()> {
    let scene = Scene::set()?;
    scene.refused_by_s2("drop_replayed", &vec![scene.frame.clone(); 20])?;
    ensure!(sum_of(&scene.fabric.proxy_stats("cloud")["node"], "seal_duplicate") == 0, "a frame came twice");
    scene.only_honest_messages_arrived()
}

/// The link id in the frame selects the link, whose key fits no other link.
#[test]
fn frames_moved_to_another_link_are_refused_by_the_next_switch() -> Result<()> {
    let scene = Scene::set()?;
    let links = scene.fabric.status(S2)?["links"].clone();
    let ids: Vec<u32> =
        links.as_array().into_iter().flatten().filter_map(|l| l["id"].as_u64()).map(|id| id as u32).collect();
    ensure!(ids.len() == 2, "{links}");
    let own = u32::from_be_bytes(scene.frame[ETHERNET + 8..ETHERNET + 12].try_into()?);
    let other = ids.iter().find(|id| **id != own).context("another link")?;
    let mut moved = scene.frame.clone();
    moved[ETHERNET + 8..ETHERNET + 12].copy_from_slice(&other.to_be_bytes());
    scene.refused_by_s2("drop_bad_tag", &vec![moved; 20])?;
    scene.only_honest_messages_arrived()
}

/// An attacker with a key, on the cable between robot and s1. The switch gives it a link like any
/// endpoint.
#[test]
fn an_endpoint_sends_only_in_its_own_name_and_to_what_it_publishes() -> Result<()> {
    let chain = ChainOptions { wire: Some(0), ..Default::default() };
    let mut fabric = Fabric::start(Tools::beside_this_test()?, FabricOptions { chain, ..Default::default() })?;
    fabric.start_proxies()?;
    let links = fabric.status(S1)?["links"].clone();
    let robot = links.as_array().into_iter().flatten().find(|link| link["role"] == "endpoint").context("the robot")?;
    let robot = name(robot["peer"].as_str().context("its name")?)?;
    let mut stranger = Stranger::attach(&fabric)?;
    let (topic, own) = (name(&fabric.name)?, stranger.name);
    let elsewhere = Name::from_bytes([0x77; 32]);
    for (reason, destination, source) in [
        ("drop_source", topic, robot),
        ("drop_source", topic, elsewhere),
        ("drop_source", elsewhere, robot),
        ("drop_not_permitted", topic, own),
        ("drop_no_route", elsewhere, own),
    ] {
        let count = |fabric: &Fabric| -> Result<u64> {
            Ok(fabric.status(S1)?["counters_by_plane"][reason]["kernel"].as_u64().unwrap_or(0))
        };
        let before = count(&fabric)?;
        stranger.send(destination, source, 20)?;
        wait_for(&format!("20 frames to be counted as {reason}"), TIMEOUT, || {
            Ok((count(&fabric)? >= before + 20).then_some(()))
        })
        .with_context(|| fabric.status(S1).unwrap_or_default()["counters"].to_string())?;
        ensure!(count(&fabric)? == before + 20, "{reason} was counted more often");
    }
    let sent_on = fabric.counter(S1, "forwarded")? + fabric.counter(S1, "delivered")?;
    // Writer and reader exchange greetings.
    ensure!(sent_on < 20, "s1 sent {sent_on} frames on");
    Ok(())
}

fn name(text: &str) -> Result<Name> {
    text.parse().map_err(|error| anyhow::anyhow!("{text}: {error}"))
}

/// An endpoint implemented by the test.
struct Stranger {
    // Fields drop in this order.
    link: Link,
    port: Port,
    _runtime: Runtime,
    name: Name,
    sent: u64,
    received: RecvBatch,
    window: Box<Window>,
}

impl Stranger {
    fn attach(fabric: &Fabric) -> Result<Self> {
        let (namespace, interface) = fabric.chain.on_the_wire()?;
        let _inside = namespace.enter()?;
        let identity = Identity::generate("proxy")?;
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
        let (port, link) = runtime.block_on(async {
            let port = Port::ethernet(interface, &PortConfig::endpoint(identity.clone()))?;
            let found = port.discover(Some(name(&fabric.switches[S1].name)?), TIMEOUT).await;
            let (to, name) = found.first().context("no answer of s1")?;
            let link = port.dial(*to, Some(*name)).await?;
            anyhow::Ok((port, link))
        })?;
        // The link enters service shortly after it is made.
        let own = identity.name().to_string();
        wait_for("s1 to take the link into service", TIMEOUT, || {
            Ok(fabric.status(S1)?["links"].to_string().contains(&own).then_some(()))
        })?;
        let (received, window) = (RecvBatch::new(2048), Box::new(replay::empty()));
        Ok(Self { link, port, _runtime: runtime, name: identity.name(), sent: 0, received, window })
    }

    /// Sends frames that are valid except for their names.
    fn send(&mut self, destination: Name, source: Name, count: usize) -> Result<()> {
        let frames: Vec<_> = (0..count).map(|_| self.stamped(Header::data(destination, source, 0))).collect();
        self.send_frames(&frames)
    }

    /// Returns the next frame on the link.
    fn stamped(&mut self, mut header: Header) -> Header {
        self.sent += 1;
        hop::stamp(&mut header, &self.link.entry(PORT_USERSPACE), self.sent);
        header
    }

    fn send_frames(&self, frames: &[Header]) -> Result<()> {
        let to = self.link.addr();
        let frames_out = frames.iter().map(|header| OutFrame { to, head: header.as_bytes(), body: &[] });
        ensure!(self.port.data().send_batch(frames_out).sent == frames.len(), "not sent");
        Ok(())
    }

    /// Receives s1's frames on the link, waiting a while for the first. Each must be one that only
    /// s1 can make.
    fn receive(&mut self, patience: Duration) -> Result<Vec<Header>> {
        let (data, entry) = (self.port.data(), self.link.entry(PORT_USERSPACE));
        if data.wait_readable(patience)? {
            data.try_recv_batch(&mut self.received)?;
        } else {
            return Ok(Vec::new());
        }
        let headers = self.received.frames().map(|InFrame { bytes: frame, .. }| {
            let (header, _) = Header::read_from_prefix(frame).map_err(|_| anyhow::anyhow!("{frame:02x?}"))?;
            match forward::accept(&header, frame.len(), &entry, &*self.window) {
                Ok(_) => Ok(header),
                Err(counter) => anyhow::bail!("{counter:?}: {header:?}"),
            }
        });
        headers.collect()
    }
}

/// Errors and echoes are signals between neighbours. Without the link's key they cannot be forged,
/// and a recorded one cannot be reused.
#[test]
fn forged_and_replayed_errors_and_echoes_are_refused_by_the_next_switch() -> Result<()> {
    let scene = Scene::set()?;
    let forged = |frame_type: u8, code: u8| {
        let mut frame = scene.frame.clone();
        (frame[ETHERNET], frame[ETHERNET + 2], frame[ETHERNET + 3]) = (0x20 | frame_type, 1, code);
        frame
    };
    let errors: Vec<_> = (0..=5).map(|code| forged(2, code)).collect();
    let echoes: Vec<_> = (0..=2).map(|kind| forged(4, kind)).collect();
    // Errors from before: a neighbour may send a greeting before a switch has its route.
    let heard = || -> Result<Vec<Value>> {
        let status = scene.fabric.status(S2)?;
        let links = status["links"].as_array().context("links")?.clone();
        Ok(links.iter().map(|link| link["errors_received"].clone()).collect())
    };
    let before = heard()?;
    scene.refused_by_s2("drop_bad_tag", &errors)?;
    scene.refused_by_s2("drop_bad_tag", &echoes)?;
    // A frame has one counter. So what had a bad tag was neither answered nor taken for an answer.
    ensure!(heard()? == before, "{before:?}: {}", scene.fabric.status(S2)?);
    scene.only_honest_messages_arrived()?;

    // From an attacker with a link: an echo is answered once, and an endpoint may not send errors.
    let chain = ChainOptions { wire: Some(0), switches: 1, ..Default::default() };
    let fabric = Fabric::start(Tools::beside_this_test()?, FabricOptions { chain, ..Default::default() })?;
    let mut stranger = Stranger::attach(&fabric)?;
    let counted = |counter: &str, expected: u64| {
        wait_for(&format!("{counter} to be {expected}"), TIMEOUT, || {
            Ok((fabric.counter(S1, counter)? == expected).then_some(()))
        })
        .with_context(|| format!("{:?}", fabric.status(S1).map(|status| status["counters"].clone())))
    };
    let echo = stranger.stamped(Header::echo(7));
    stranger.send_frames(&[echo, echo, echo])?;
    counted("echoed", 1)?;
    counted("drop_replayed", 2)?;
    let answers = stranger.receive(TIMEOUT)?;
    let is_answer = |header: &Header| (header.egress_bits(), header.egress_set) == (7, Header::ANSWERS);
    ensure!(answers.len() == 1 && answers.iter().all(is_answer), "{answers:?}");
    let mut error = Header::data(Name::default(), stranger.name, 0);
    error.become_error(ErrorCode::NotAuthorised, 0);
    let mut unknown = error;
    unknown.egress_set = 99;
    let frames = [stranger.stamped(error), stranger.stamped(error), stranger.stamped(unknown)];
    stranger.send_frames(&frames)?;
    counted("drop_unknown", 3)?;
    let (status, none) = (fabric.status(S1)?, serde_json::json!({}));
    ensure!(status["counters"]["notice"] == 0 && status["links"][0]["errors_received"] == none, "{status}");
    let answers = stranger.receive(Duration::ZERO)?;
    ensure!(answers.is_empty(), "an error was answered: {answers:?}");
    Ok(())
}

/// An endpoint with a link sends to a million unknown names, as fast as a socket allows.
#[test]
fn a_flood_of_unknown_names_draws_few_errors_and_stops_nobody() -> Result<()> {
    const NAMES: u64 = 1_000_000;
    let chain = ChainOptions { wire: Some(0), ..Default::default() };
    let mut fabric = Fabric::start(Tools::beside_this_test()?, FabricOptions { chain, ..Default::default() })?;
    fabric.start_proxies()?;
    let traffic = Traffic::default();
    let talks = Side { at: fabric.chain.robot(), vendor: Vendor::Cyclone, traffic: &traffic };
    let hears = Side { at: fabric.chain.cloud(), vendor: Vendor::FastDds, traffic: &traffic };
    let conversation = Conversation::start(&fabric.tools, talks, hears, fabric.folder())?;
    conversation.open()?;
    let mut stranger = Stranger::attach(&fabric)?;
    let (memory, names) = (resident(&fabric)?, fabric.status(S1)?["fib"].clone());
    let heard = || peers::received(&conversation.listener).len();
    let (before, began) = (heard(), Instant::now());
    let (mut sent, mut errors) = (0, 0);
    // Runs long enough to see that messages arrive meanwhile.
    while sent < NAMES || heard() < before + 20 {
        ensure!(sent < NAMES || began.elapsed() < 3 * TIMEOUT, "only {} messages arrived", heard() - before);
        let batch: Vec<_> = (sent..sent + 64)
            .map(|n| {
                let mut bytes = [0xee; 32];
                bytes[..8].copy_from_slice(&n.to_le_bytes());
                stranger.stamped(Header::data(Name::from_bytes(bytes), stranger.name, 0))
            })
            .collect();
        stranger.send_frames(&batch)?;
        sent += batch.len() as u64;
        for error in stranger.receive(Duration::ZERO)? {
            ensure!(error.version_type == 0x22 && error.egress_set == ErrorCode::NoRoute as u8, "{error:?}");
            errors += 1;
        }
    }
    let took = began.elapsed();
    let during = heard() - before;
    let messages = &peers::received(&conversation.listener)[before..];
    let span = messages.last().map_or(0, |m| m.sequence) - messages.first().map_or(0, |m| m.sequence) + 1;
    ensure!(2 * messages.len() as i64 > span, "only {} of {span} messages arrived", messages.len());
    let dropped = fabric.counter(S1, "drop_no_route")?;
    println!("{sent} names in {took:?}: {dropped} dropped, {errors} errors; {during} messages arrived meanwhile");
    // A bridge and a veth on the path lose part of a flood.
    ensure!(dropped > sent / 2 && fabric.status(S1)?["counters_by_plane"]["drop_no_route"]["userspace"] == 0);
    ensure!(errors > 0 && errors <= 1 + took.as_millis() as u64 / 10, "{errors} errors in {took:?}");
    ensure!(fabric.status(S1)?["fib"] == names, "the flood changed the FIB");
    let grown = resident(&fabric)?.saturating_sub(memory);
    ensure!(grown < 2048, "the daemon grew by {grown} KiB");
    Ok(())
}

/// Returns the resident memory of the daemon of s1 in KiB.
fn resident(fabric: &Fabric) -> Result<u64> {
    resident_of(fabric.switches[S1].process.pid())
}

/// Returns the resident memory of a process in KiB.
fn resident_of(pid: u32) -> Result<u64> {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status"))?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).context("VmRSS")?;
    Ok(line.trim().trim_end_matches(" kB").parse()?)
}

/// Flips every bit of the header. A switch detects wrong link ids and lengths before the tag. It
/// detects another source by the count, which the frame itself has used up.
#[test]
fn flipped_header_bits_are_refused_by_the_next_switch() -> Result<()> {
    let scene = Scene::set()?;
    let flips = |bytes: std::ops::Range<usize>| {
        (bytes.start * 8..bytes.end * 8).map(|bit| scene.flipped(bit)).collect::<Vec<_>>()
    };
    // Flags, hop limit, egress set; reserved; counter, tag, egress bits and destination.
    scene.refused_by_s2("drop_bad_tag", &flips(1..4))?;
    scene.refused_by_s2("drop_bad_tag", &flips(7..8))?;
    scene.refused_by_s2("drop_bad_tag", &flips(12..SOURCE))?;
    scene.refused_by_s2("drop_replayed", &flips(SOURCE..HEADER))?;
    scene.refused_by_s2("drop_no_link", &flips(8..12))?;
    // Payload length: longer than the frame, or shorter than tagged.
    let (longer, shorter) =
        flips(4..6).into_iter().partition::<Vec<_>, _>(|frame| payload_length(frame) > payload_length(&scene.frame));
    scene.refused_by_s2("drop_truncated", &longer)?;
    scene.refused_by_s2("drop_bad_tag", &shorter)?;
    // Header length; version and type, except for the bits that make an error and an echo.
    scene.refused_by_s2("drop_unknown", &flips(6..7))?;
    scene.refused_by_s2("drop_unknown", &[0, 3, 4, 5, 6, 7].map(|bit| scene.flipped(bit)))?;
    scene.refused_by_s2("drop_bad_tag", &[scene.flipped(1), scene.flipped(2)])?;
    scene.only_honest_messages_arrived()
}

/// The attacker holds frames back and alters the source, which no tag covers between switches. The
/// reader has no key of such a writer.
#[test]
fn a_source_flipped_on_its_way_is_no_writer_to_the_reader() -> Result<()> {
    let scene = Scene::set()?;
    const ALTERED: usize = 20;
    let refused = |fabric: &Fabric| Ok(all_drops(&fabric.proxy_stats("cloud")["node"]));
    let before = refused(&scene.fabric)?;
    scene.hand_on(ALTERED, |n, frame| flip(frame, SOURCE..HEADER, n, ALTERED))?;
    scene.wait_for_count("all drops of the reader", before + ALTERED as u64, refused)?;
    scene.no_dishonest_message_arrived().map(drop)
}

#[test]
fn flipped_payload_bits_are_refused_by_the_reader() -> Result<()> {
    let scene = Scene::set()?;
    const ALTERED: usize = 20;
    let refused = |fabric: &Fabric| Ok(all_drops(&fabric.proxy_stats("cloud")["node"]));
    let before = refused(&scene.fabric)?;
    scene.hand_on(ALTERED, |n, frame| {
        let end = frame.len() - ETHERNET;
        flip(frame, HEADER..end, n, ALTERED);
    })?;
    scene.wait_for_count("all drops of the reader", before + ALTERED as u64, refused)?;
    scene.no_dishonest_message_arrived().map(drop)
}

#[test]
fn truncated_frames_are_refused_by_the_next_switch() -> Result<()> {
    let scene = Scene::set()?;
    let cuts: Vec<_> = (ETHERNET + 1..scene.frame.len()).map(|length| scene.frame[..length].to_vec()).collect();
    scene.refused_by_s2("drop_truncated", &cuts)?;
    scene.only_honest_messages_arrived()
}

/// The attacker knows the format, the names and the link, but not the link's key.
#[test]
fn forged_frames_are_refused_by_the_next_switch() -> Result<()> {
    let scene = Scene::set()?;
    let forged: Vec<_> = (0..200u64)
        .map(|n| {
            let mut frame = scene.frame.clone();
            let guess = n.wrapping_mul(0x9e37_79b9_7f4a_7c15).to_be_bytes();
            frame[ETHERNET + 16..ETHERNET + 24].copy_from_slice(&guess);
            frame
        })
        .collect();
    scene.refused_by_s2("drop_bad_tag", &forged)?;
    scene.only_honest_messages_arrived()
}

/// Flips the `n`-th of `times` bits that are spread over a range of bytes of the GDP frame.
fn flip(frame: &mut [u8], bytes: std::ops::Range<usize>, n: usize, times: usize) {
    let bit = n * bytes.len() * 8 / times + n % 8;
    frame[ETHERNET + bytes.start + bit / 8] ^= 1 << (bit % 8);
}

fn is_gdp(frame: &[u8]) -> bool {
    frame.len() > ETHERNET && frame[12..14] == GDP_ETHERTYPE.to_be_bytes()
}

fn payload_length(frame: &[u8]) -> u16 {
    u16::from_be_bytes([frame[ETHERNET + 4], frame[ETHERNET + 5]])
}

/// Returns the sum of the numbers under `key`, at any depth.
fn sum_of(value: &Value, key: &str) -> u64 {
    match value {
        Value::Object(fields) => fields
            .iter()
            .map(|(k, v)| if k == key { v.as_u64().unwrap_or_else(|| sum_of(v, key)) } else { sum_of(v, key) })
            .sum(),
        Value::Array(values) => values.iter().map(|v| sum_of(v, key)).sum(),
        _ => 0,
    }
}

/// Returns the sum of all numbers under any `drops`.
fn all_drops(value: &Value) -> u64 {
    fn total(value: &Value) -> u64 {
        match value {
            Value::Object(fields) => fields.values().map(total).sum(),
            other => other.as_u64().unwrap_or(0),
        }
    }
    match value {
        Value::Object(fields) => {
            fields.iter().map(|(key, v)| if key == "drops" { total(v) } else { all_drops(v) }).sum()
        }
        Value::Array(values) => values.iter().map(all_drops).sum(),
        _ => 0,
    }
}
