//! DDS traffic in a graph with a proxy: user data stays on the host of its nodes, in as many copies
//! as there are readers. Between proxies it is sealed.
//!
//! ```text
//!   arm ── in0 robot up0 ── e0 cloud: proxy, nodes of another domain
//!              lo: nodes, proxy, daemon
//! ```

mod doubler;
mod site;

use std::collections::BTreeMap;
use std::fs;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use gdp_tests::fabric::TOPIC;
use gdp_tests::netns::{End, Namespace, veth};
use gdp_tests::packet::{ETHERNET, PacketSocket};
use gdp_tests::process::Process;
use gdp_tests::wait::{TIMEOUT, wait_for};

use crate::logs::foreign_lines;
use doubler::Doubler;
use site::{COMMANDS, Site, TEXT, Vendor};

/// Bytes before the text: sequence number, clock and checksum (`tests/peers/README.md`).
const HEAD: usize = 43;

#[test]
fn messages_of_a_robot_stay_on_loopback_once_each() -> Result<()> {
    for vendor in Vendor::ALL {
        let site = Site::build(1)?;
        let mut talker =
            site.talk(vendor, &site.robot, 0, TOPIC, &["--count", "100", "--rate", "50", "--size", "200"])?;
        let mut listener = site.listen(Vendor::Cyclone, &site.cloud, 1, TOPIC)?;
        let counts = Counts::capture(&site, &mut talker, &mut [&mut listener], 100)?;
        counts.check(100, 1).with_context(|| format!("{vendor:?}: {counts:?}\n{}", site.report()))?;
    }
    Ok(())
}

#[test]
fn messages_for_a_robot_stay_on_loopback_once_for_each_subscriber() -> Result<()> {
    let site = Site::build(1)?;
    let vendors = Vendor::ALL;
    let mut listeners = Vec::new();
    for vendor in vendors {
        listeners.push(site.listen(vendor, &site.robot, 0, COMMANDS)?);
    }
    let options = ["--count", "100", "--rate", "50", "--size", "200"];
    let mut talker = site.talk(Vendor::FastDds, &site.cloud, 1, COMMANDS, &options)?;
    let mut all: Vec<_> = listeners.iter_mut().collect();
    let counts = Counts::capture(&site, &mut talker, &mut all, 100)?;
    counts.check(100, vendors.len()).with_context(|| format!("{counts:?}\n{}", site.report()))
}

/// Reproduces a network whose switch or driver duplicates datagrams, or DDS repairs of delayed
/// samples.
#[test]
fn a_large_reliable_topic_goes_on_where_every_datagram_comes_twice() -> Result<()> {
    const MESSAGES: u64 = 200;
    let mut site = Site::build(1)?;
    let _doubler = Doubler::start(&site.robot)?;
    let mut listener = site.listen(Vendor::FastDds, &site.cloud, 1, TOPIC)?;
    let options = ["--count", "200", "--rate", "10", "--size", "6000000"];
    let mut talker = site.talk(Vendor::FastDds, &site.robot, 0, TOPIC, &options)?;
    fs::write(site.gate(), "")?;
    talker.wait_event("done", TIMEOUT)?;
    let crossed = || site.stats("robot")["topics"][0]["messages"].as_u64().unwrap_or(0);
    wait_for("all messages", Duration::from_secs(40), || Ok((crossed() >= MESSAGES).then_some(())))
        .with_context(|| format!("{} of {MESSAGES}; {}", crossed(), site.stats("robot")["topics"][0]))?;

    // The proxy at the other end has written large messages.
    listener.wait_event("message", TIMEOUT).with_context(|| site.report())?;
    for proxy in &mut site.proxies {
        ensure!(proxy.stop(TIMEOUT)?.success(), "{}", proxy.report());
        let log = proxy.stderr();
        ensure!(foreign_lines(&log).is_empty(), "{log}");
    }
    Ok(())
}

/// A robot's proxy starts at boot, before the cable to its second computer is plugged in.
#[test]
fn an_interface_that_comes_up_later_is_joined() -> Result<()> {
    let mut site = Site::build(1)?;
    let mut listener = site.listen(Vendor::Cyclone, &site.cloud, 1, TOPIC)?;
    for proxy in &mut site.proxies {
        proxy.wait_until("the graphs", TIMEOUT, |proxy| proxy.stderr().contains("in the ROS graphs").then_some(()))?;
    }
    let lidar = Namespace::create("lidar")?;
    let mac = |end| [2, 0, 0, 5, end, 9];
    let near = End { namespace: &site.robot, interface: "in1", mac: mac(0) };
    veth(&near, &End { namespace: &lidar, interface: "e0", mac: mac(1) }, 1500)?;
    site.robot.ip(&["addr", "add", "10.77.9.2/24", "dev", "in1"])?;
    lidar.ip(&["addr", "add", "10.77.9.3/24", "dev", "e0"])?;
    let _talker = site.talk(Vendor::Rclpy, &lidar, 0, TOPIC, &[])?;
    listener.wait_event("message", TIMEOUT).with_context(|| site.report())?;
    Ok(())
}

/// A node of this host can be discovered with either range, and one of another host with SUBNET
/// alone.
#[test]
fn nodes_of_other_hosts_are_discovered_if_the_range_is_the_subnet() -> Result<()> {
    let mut site = Site::build(1)?;
    site.restart_robot_proxy("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")?;
    let mut listener = site.listen(Vendor::Cyclone, &site.cloud, 1, TOPIC)?;
    let _elsewhere = site.talk(Vendor::Rclpy, &site.arm, 0, TOPIC, &["--text", "elsewhere"])?;
    // Programs of the robot without a range discover it.
    let mut witness = site.listen(Vendor::FastDds, &site.robot, 0, TOPIC)?;
    witness.wait_event("message", TIMEOUT)?;
    let _here = site.talk(Vendor::Rclpy, &site.robot, 0, TOPIC, &["--text", "here"])?;
    let texts = |process: &Process| -> Vec<String> {
        let lines = process.json_lines();
        lines.iter().filter_map(|line| Some(line["text"].as_str()?.split(' ').next()?.to_owned())).collect()
    };
    let heard = listener.wait_until("twenty messages", TIMEOUT, |p| Some(texts(p)).filter(|texts| texts.len() >= 20));
    let heard = heard.with_context(|| site.report())?;
    ensure!(heard.iter().all(|text| text == "here"), "with the range LOCALHOST: {heard:?}");

    site.restart_robot_proxy("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")?;
    let both = |process: &Process| {
        ["here", "elsewhere"].iter().all(|text| texts(process)[heard.len()..].iter().any(|heard| heard == text))
    };
    listener.wait_until("both talkers", TIMEOUT, |process| both(process).then_some(())).with_context(|| site.report())
}

/// The access point of a robot may drop multicast.
#[test]
fn a_static_peer_is_found_without_multicast() -> Result<()> {
    let mut site = Site::build(1)?;
    let mut listener = site.listen(Vendor::Cyclone, &site.cloud, 1, TOPIC)?;
    // Without multicast, and told of no other host.
    let _talker = site.talk(Vendor::Cyclone, &site.arm, 0, TOPIC, &["--peer", "10.77.1.3"])?;
    site.restart_robot_proxy("ROS_STATIC_PEERS", "10.77.1.3")?;
    listener.wait_event("message", TIMEOUT).with_context(|| site.report())?;
    Ok(())
}

/// A robot's Wi-Fi loses a datagram of several IP fragments much more often than one of a single
/// frame.
#[test]
fn announcements_larger_than_a_frame_travel_as_fragments_of_rtps() -> Result<()> {
    const TOPICS: usize = 120;
    let mut site = Site::build(TOPICS)?;
    let socket = PacketSocket::open(&site.arm, "e0")?;
    socket.set_receive_buffer(64 << 20)?;
    let _talker = site.talk(Vendor::FastDds, &site.cloud, 1, COMMANDS, &["--topics", &TOPICS.to_string()])?;
    let mut graph = site.arm.command(site.tools.python()?)?;
    graph.arg(site.tools.peer("rclpy_graph.py")).env("ROS_DOMAIN_ID", "0").env("ROS_LOG_DIR", site.folder.path());
    let mut graph = Process::spawn("graph", graph, site.folder.path())?;
    // All endpoints of one node are in one announcement, with 16 bytes each.
    let all_mirrored = |graph: &Process| {
        let latest = graph.json_lines().pop()?;
        let nodes = latest["nodes"].as_object()?;
        let most = nodes.values().filter_map(|node| Some(node["publishers"].as_object()?.len())).max()?;
        (most >= TOPICS).then_some(())
    };
    graph.wait_until("all publishers", TIMEOUT, all_mirrored).with_context(|| site.report())?;
    let (mut datagrams, mut rtps_fragments) = (0, 0);
    let mut buffer = vec![0; 1 << 17];
    while let Some(length) = socket.try_receive(&mut buffer)? {
        let frame = &buffer[..length];
        if frame[12..14] == [8, 0] {
            datagrams += 1;
            let fragment = u16::from_be_bytes([frame[ETHERNET + 6], frame[ETHERNET + 7]]) & 0x3fff;
            ensure!(fragment == 0, "an IP fragment in a frame of {} bytes", frame.len());
            rtps_fragments += usize::from(is_rtps_fragment(frame));
        }
    }
    ensure!(rtps_fragments > 0, "none of {datagrams} datagrams is a fragment, though the announcement is larger");
    for proxy in &mut site.proxies {
        proxy.check_alive()?;
    }
    Ok(())
}

/// As the history policy KEEP_LAST requires: a writer replaces its oldest sample and waits for no
/// reader.
#[test]
fn a_subscriber_that_was_killed_takes_nothing_from_the_others() -> Result<()> {
    const MESSAGES: i64 = 1200;
    let site = Site::build(1)?;
    let mut healthy = site.peer(Vendor::FastDds, &site.cloud, "listen", 1, TOPIC)?;
    healthy.args(["--depth", &MESSAGES.to_string()]);
    let mut healthy = Process::spawn("healthy", healthy, site.folder.path())?;
    let mut killed = site.listen(Vendor::Rclpy, &site.cloud, 1, TOPIC)?;
    let options = ["--count", &MESSAGES.to_string(), "--rate", "300", "--size", "200"];
    let mut talker = site.talk(Vendor::FastDds, &site.robot, 0, TOPIC, &options)?;
    for listener in [&mut healthy, &mut killed] {
        listener.wait_event("message", TIMEOUT).with_context(|| site.report())?;
    }
    killed.kill()?;
    fs::write(site.gate(), "")?;
    talker.wait_event("done", TIMEOUT)?;
    let received = |process: &Process| -> Vec<i64> {
        process.json_lines().iter().filter_map(|line| line["seq"].as_i64()).filter(|sequence| *sequence >= 0).collect()
    };
    // Twice the talker's duration: a reader whose lease has not expired must not delay the others.
    let last = |process: &Process| (received(process).last() == Some(&(MESSAGES - 1))).then_some(());
    healthy.wait_until("the last message", Duration::from_secs(8), last)?;
    ensure!(received(&healthy) == (0..MESSAGES).collect::<Vec<_>>(), "{} of {MESSAGES}", received(&healthy).len());
    Ok(())
}

/// Whether an RTPS message has a DATA_FRAG submessage (RTPS 2.5, 9.4.5.1).
fn is_rtps_fragment(frame: &[u8]) -> bool {
    const DATA_FRAG: u8 = 0x16;
    const RTPS_HEADER: usize = 20;
    let Some(mut rest) = frame.get(ETHERNET + 28 + RTPS_HEADER..) else { return false };
    while let [kind, flags, a, b, ..] = *rest {
        let is_little_endian = flags & 1 == 1;
        let length = if is_little_endian { u16::from_le_bytes([a, b]) } else { u16::from_be_bytes([a, b]) };
        match (kind, rest.get(4 + usize::from(length)..)) {
            (DATA_FRAG, _) => return true,
            (_, Some(next)) if length > 0 => rest = next,
            _ => return false,
        }
    }
    false
}

/// Number of copies of each message, by sequence number.
type Copies = BTreeMap<i64, usize>;

#[derive(Debug)]
struct Counts {
    loopback: Copies,
    uplink: Copies,
    arm: Copies,
}

impl Counts {
    /// Captures on the interfaces while the talker sends its messages, until all listeners have the
    /// last one.
    fn capture(site: &Site, talker: &mut Process, listeners: &mut [&mut Process], messages: i64) -> Result<Self> {
        for listener in listeners.iter_mut() {
            listener.wait_event("message", TIMEOUT).with_context(|| site.report())?;
        }
        let sockets = [(&site.robot, "lo"), (&site.cloud, "e0"), (&site.arm, "e0")];
        let sockets = sockets.map(|(at, interface)| PacketSocket::open(at, interface));
        let [loopback, uplink, arm] = sockets;
        let sockets = [loopback?, uplink?, arm?];
        sockets.iter().try_for_each(|socket| socket.set_receive_buffer(64 << 20))?;
        fs::write(site.gate(), "")?;
        talker.wait_event("done", TIMEOUT)?;
        for listener in listeners.iter_mut() {
            let last = |p: &Process| p.json_lines().iter().any(|line| line["seq"] == messages - 1).then_some(());
            listener.wait_until("the last message", TIMEOUT, last)?;
        }
        let [loopback, uplink, arm] = sockets.each_ref().map(copies);
        Ok(Self { loopback: loopback?, uplink: uplink?, arm: arm? })
    }

    fn check(&self, messages: i64, copies: usize) -> Result<()> {
        ensure!(self.uplink.is_empty(), "messages in clear on the uplink");
        ensure!(self.arm.is_empty(), "messages on an interface without readers");
        let expected: Copies = (0..messages).map(|sequence| (sequence, copies)).collect();
        ensure!(self.loopback == expected, "not {copies} copies on loopback");
        Ok(())
    }
}

/// Returns the messages in the frames that have arrived so far.
fn copies(socket: &PacketSocket) -> Result<Copies> {
    let mut copies = Copies::new();
    let mut buffer = vec![0; 1 << 17];
    while let Some(length) = socket.try_receive(&mut buffer)? {
        let frame = &buffer[..length];
        let Some(text) = frame.windows(TEXT.len()).position(|bytes| bytes == TEXT.as_bytes()) else { continue };
        let head = text.checked_sub(HEAD).and_then(|start| frame.get(start..)).context("a message without a head")?;
        let sequence: i64 = std::str::from_utf8(&head[..10])?.parse()?;
        if sequence >= 0 {
            *copies.entry(sequence).or_default() += 1;
        }
    }
    ensure!(socket.dropped()? == 0, "frames were not seen");
    Ok(copies)
}
