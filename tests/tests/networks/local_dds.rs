//! DDS traffic in a graph with a proxy: user data stays on the host of its nodes, in as many copies
//! as there are readers. Between proxies it is sealed.
//!
//! ```text
//!   arm ── in0 robot up0 ── e0 cloud: proxy, nodes of another domain
//!              lo: nodes, proxy, daemon
//! ```

use std::collections::BTreeMap;
use std::fs;
use std::io::PipeWriter;
use std::os::fd::AsRawFd;
use std::path::PathBuf;
use std::process::Command;
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use gdp_tests::Tools;
use gdp_tests::fabric::{Authority, Switch, TOPIC, TYPE};
use gdp_tests::netns::{End, Namespace, veth};
use gdp_tests::packet::{ETHERNET, PacketSocket};
use gdp_tests::process::Process;
use gdp_tests::wait::{TIMEOUT, wait_for};
use serde_json::{Value, json};

use crate::logs::foreign_lines;

/// The topic that crosses from the cloud to the robot.
const COMMANDS: &str = "/commands";

/// The text of messages, which occurs in no other traffic.
const TEXT: &str = "for nodes of this graph alone";

/// Bytes before the text: sequence number, clock and checksum (`tests/peers/README.md`).
const HEAD: usize = 43;

#[test]
fn messages_of_a_robot_stay_on_loopback_once_each() -> Result<()> {
    for vendor in [Vendor::Rclpy, Vendor::FastDds, Vendor::Cyclone] {
        let mut site = Site::build(1)?;
        let mut talker =
            site.talk(vendor, &site.robot, 0, TOPIC, &["--count", "100", "--rate", "50", "--size", "200"])?;
        let mut listener = site.listen(Vendor::Cyclone, &site.cloud, 1, TOPIC)?;
        let counts = site.copies_until_heard(&mut talker, &mut [&mut listener], 100)?;
        counts.check(100, 1).with_context(|| format!("{vendor:?}: {counts:?}\n{}", site.report()))?;
    }
    Ok(())
}

#[test]
fn messages_for_a_robot_stay_on_loopback_once_for_each_subscriber() -> Result<()> {
    let mut site = Site::build(1)?;
    let vendors = [Vendor::Rclpy, Vendor::FastDds, Vendor::Cyclone];
    let mut listeners = Vec::new();
    for vendor in vendors {
        listeners.push(site.listen(vendor, &site.robot, 0, COMMANDS)?);
    }
    let options = ["--count", "100", "--rate", "50", "--size", "200"];
    let mut talker = site.talk(Vendor::FastDds, &site.cloud, 1, COMMANDS, &options)?;
    let mut all: Vec<_> = listeners.iter_mut().collect();
    let counts = site.copies_until_heard(&mut talker, &mut all, 100)?;
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

/// The access point of a robot may drop multicast.
#[test]
fn a_static_peer_is_found_without_multicast() -> Result<()> {
    let mut site = Site::build(1)?;
    let mut listener = site.listen(Vendor::Cyclone, &site.cloud, 1, TOPIC)?;
    // Without multicast, and told of no other host.
    let _talker = site.talk(Vendor::Cyclone, &site.arm, 0, TOPIC, &["--peer", "10.77.1.3"])?;
    ensure!(site.proxies[0].stop(TIMEOUT)?.success(), "{}", site.report());
    let mut command = site.robot.command(site.tools.gdp_proxy()?)?;
    command.arg("--config").arg(site.folder.path().join("robot/proxy.yaml")).env("ROS_STATIC_PEERS", "10.77.1.3");
    site.proxies[0] = Process::spawn("robot-proxy", command, site.folder.path())?;
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

/// Returns the name of one of the topics that cross to the robot.
fn command_topic(number: usize) -> String {
    if number == 0 { COMMANDS.to_owned() } else { format!("{COMMANDS}{number}") }
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

#[derive(Clone, Copy, Debug)]
enum Vendor {
    /// A newer Fast DDS.
    Rclpy,
    FastDds,
    Cyclone,
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
    fn check(&self, messages: i64, copies: usize) -> Result<()> {
        ensure!(self.uplink.is_empty(), "messages in clear on the uplink");
        ensure!(self.arm.is_empty(), "messages on an interface without readers");
        let expected: Copies = (0..messages).map(|sequence| (sequence, copies)).collect();
        ensure!(self.loopback == expected, "not {copies} copies on loopback");
        Ok(())
    }
}

/// A running site. Dropping it ends the programs, then deletes the namespaces and files.
struct Site {
    proxies: Vec<Process>,
    _switch: Switch,
    robot: Namespace,
    arm: Namespace,
    cloud: Namespace,
    tools: Tools,
    folder: tempfile::TempDir,
}

impl Site {
    /// `commands` topics cross to the robot: [`COMMANDS`], and others with a number appended.
    fn build(commands: usize) -> Result<Self> {
        let tools = Tools::beside_this_test()?;
        let [robot, arm, cloud] = [Namespace::create("robot")?, Namespace::create("arm")?, Namespace::create("cloud")?];
        for (i, (interface, other)) in [("up0", &cloud), ("in0", &arm)].into_iter().enumerate() {
            let mac = |end| [2, 0, 0, 5, end, i as u8];
            let near = End { namespace: &robot, interface, mac: mac(0) };
            veth(&near, &End { namespace: other, interface: "e0", mac: mac(1) }, 1500)?;
            robot.ip(&["addr", "add", &format!("10.77.{i}.2/24"), "dev", interface])?;
            other.ip(&["addr", "add", &format!("10.77.{i}.3/24"), "dev", "e0"])?;
        }
        // The robot resembles a host with a default route; the far side, a host that restricts DDS
        // to itself.
        robot.ip(&["route", "add", "default", "via", "10.77.0.3"])?;
        cloud.enable_loopback_multicast()?;

        let folder = tempfile::Builder::new().prefix("gdp-local-dds-").tempdir()?;
        let authority = Authority { tools: &tools, folder: folder.path() };
        let name = authority.switch("s1")?;
        let config = json!({"interfaces": [], "udp": "0.0.0.0:31415", "data_plane": "userspace", "rib": true});
        let switch = Switch::start(&tools, &robot, folder.path(), ("s1", &name), config)?;
        wait_for("the switch", TIMEOUT, || Ok(switch.ctl(&tools, &["status"]).ok()))?;
        authority.topic()?;
        for i in 0..commands {
            authority.name("topic", &command_topic(i), TYPE, &format!("commands{i}.card"))?;
        }
        let mut site = Self { proxies: Vec::new(), _switch: switch, robot, arm, cloud, tools, folder };
        for (i, (label, to)) in [("robot", "udp://127.0.0.1"), ("cloud", "udp://10.77.0.2")].into_iter().enumerate() {
            let proxy = site.proxy(label, i, to, commands)?;
            site.proxies.push(proxy);
        }
        Ok(site)
    }

    /// Starts a proxy. The robot's publishes [`TOPIC`] and reads the commands; the other one does
    /// the reverse.
    fn proxy(&self, label: &str, domain: usize, link: &str, commands: usize) -> Result<Process> {
        let authority = Authority { tools: &self.tools, folder: self.folder.path() };
        let entity = authority.proxy(label)?;
        let chatter = ("chatter".to_owned(), TOPIC.to_owned(), 0);
        let commands = (0..commands).map(|i| (format!("commands{i}"), command_topic(i), 1));
        let topics = std::iter::once(chatter).chain(commands).map(|(file, topic, source)| {
            let (direction, key, right) =
                if source == domain { ("out", "cert", "--publish") } else { ("in", "grant", "--read") };
            authority.hand(label, &entity, &[right], &file)?;
            let (card, cert) = (format!("{file}.card"), format!("{file}.cert"));
            Ok(json!({"topic": topic, "direction": direction, "card": card, (key): cert}))
        });
        let config = json!({
            "version": 1, "identity": "key.pem", "links": [{"to": link}],
            "graphs": {"ros2": {"domain_id": domain}}, "topics": topics.collect::<Result<Vec<_>>>()?,
        });
        let path = self.folder.path().join(label).join("proxy.yaml");
        // JSON is YAML.
        fs::write(&path, config.to_string())?;
        let at = if domain == 0 { &self.robot } else { &self.cloud };
        let mut command = at.command(self.tools.gdp_proxy()?)?;
        command.arg("--config").arg(path).arg("--stats").arg(self.stats_file(label));
        Process::spawn(&format!("{label}-proxy"), command, self.folder.path())
    }

    fn talk(&self, vendor: Vendor, at: &Namespace, domain: u16, topic: &str, options: &[&str]) -> Result<Process> {
        let mut command = self.peer(vendor, at, "talk", domain, topic)?;
        command.args(["--text", TEXT]).args(options).arg("--gate").arg(self.gate());
        Process::spawn("talker", command, self.folder.path())
    }

    fn listen(&self, vendor: Vendor, at: &Namespace, domain: u16, topic: &str) -> Result<Process> {
        let command = self.peer(vendor, at, "listen", domain, topic)?;
        Process::spawn(&format!("{vendor:?}-listener"), command, self.folder.path())
    }

    fn peer(&self, vendor: Vendor, at: &Namespace, verb: &str, domain: u16, topic: &str) -> Result<Command> {
        let (domain, dds) = (domain.to_string(), format!("rt{topic}"));
        let command = match vendor {
            Vendor::FastDds => at.command(self.tools.fastdds()?)?,
            Vendor::Cyclone | Vendor::Rclpy => at.command(self.tools.python()?)?,
        };
        let mut command = command;
        match vendor {
            Vendor::FastDds => command.args([verb, "--domain", &domain, "--topic", &dds]),
            Vendor::Cyclone => command.arg(self.tools.cyclone()).args([verb, "--domain", &domain, "--topic", &dds]),
            Vendor::Rclpy => {
                command.arg(self.tools.peer("rclpy_topic.py")).args([verb, "--topic", topic]);
                command.env("ROS_DOMAIN_ID", domain).env("ROS_LOG_DIR", self.folder.path());
                // UDP alone: two Fast DDS programs on one machine would otherwise communicate
                // through shared memory.
                command.env("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
            }
        };
        Ok(command)
    }

    /// Captures on the interfaces while the talker sends its messages, until all listeners have the
    /// last one.
    fn copies_until_heard(
        &mut self,
        talker: &mut Process,
        listeners: &mut [&mut Process],
        messages: i64,
    ) -> Result<Counts> {
        for listener in listeners.iter_mut() {
            listener.wait_event("message", TIMEOUT).with_context(|| self.report())?;
        }
        let sockets = [(&self.robot, "lo"), (&self.cloud, "e0"), (&self.arm, "e0")];
        let sockets = sockets.map(|(at, interface)| PacketSocket::open(at, interface));
        let [loopback, uplink, arm] = sockets;
        let sockets = [loopback?, uplink?, arm?];
        sockets.iter().try_for_each(|socket| socket.set_receive_buffer(64 << 20))?;
        fs::write(self.gate(), "")?;
        talker.wait_event("done", TIMEOUT)?;
        for listener in listeners.iter_mut() {
            let last = |p: &Process| p.json_lines().iter().any(|line| line["seq"] == messages - 1).then_some(());
            listener.wait_until("the last message", TIMEOUT, last)?;
        }
        let [loopback, uplink, arm] = sockets.each_ref().map(copies);
        Ok(Counts { loopback: loopback?, uplink: uplink?, arm: arm? })
    }

    /// Returns the gate file. Talkers send warm-up messages until it exists.
    fn gate(&self) -> PathBuf {
        self.folder.path().join("gate")
    }

    fn stats_file(&self, label: &str) -> PathBuf {
        self.folder.path().join(label).join("stats.json")
    }

    fn stats(&self, label: &str) -> Value {
        let text = fs::read(self.stats_file(label)).unwrap_or_default();
        serde_json::from_slice(&text).unwrap_or_default()
    }

    fn report(&self) -> String {
        self.proxies.iter().map(Process::report).collect::<Vec<_>>().join("\n")
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

/// Sends each datagram to a user data port on a loopback interface a second time, until this guard
/// is dropped.
struct Doubler {
    thread: Option<JoinHandle<Result<()>>>,
    /// Closing this pipe ends the thread.
    running: Option<PipeWriter>,
}

impl Doubler {
    fn start(at: &Namespace) -> Result<Self> {
        {
            let _inside = at.enter()?;
            // Otherwise the kernel drops the copies, because their source addresses are the host's
            // own.
            for (setting, value) in [("accept_local", "1"), ("route_localnet", "1"), ("rp_filter", "0")] {
                for scope in ["all", "lo"] {
                    fs::write(format!("/proc/sys/net/ipv4/conf/{scope}/{setting}"), value)
                        .with_context(|| format!("cannot set {setting} in {}", at.name()))?;
                }
            }
        }
        let socket = PacketSocket::open(at, "lo")?;
        socket.set_receive_buffer(64 << 20)?;
        let (stopped, running) = std::io::pipe()?;
        let thread = std::thread::spawn(move || {
            let mut buffer = vec![0; 1 << 17];
            loop {
                let mut polls = [socket.as_raw_fd(), stopped.as_raw_fd()].map(readable);
                // SAFETY: two live pollfds.
                unsafe { libc::poll(polls.as_mut_ptr(), polls.len() as libc::nfds_t, -1) };
                if polls[1].revents != 0 {
                    return Ok(());
                }
                while let Some(length) = socket.try_receive(&mut buffer)? {
                    if mark_copy(&mut buffer[..length]) {
                        socket.send(&buffer[..length])?;
                    }
                }
            }
        });
        Ok(Self { thread: Some(thread), running: Some(running) })
    }
}

impl Drop for Doubler {
    fn drop(&mut self) {
        self.running = None;
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(Ok(()))) | None => {}
            Some(failed) => eprintln!("the doubler: {failed:?}"),
        }
    }
}

fn readable(fd: i32) -> libc::pollfd {
    libc::pollfd { fd, events: libc::POLLIN, revents: 0 }
}

/// Marks a datagram to the user data port of the first participants of domain 0 as a copy. Returns
/// false for other frames, and for copies.
fn mark_copy(frame: &mut [u8]) -> bool {
    /// A byte of the source MAC address, which is zero on a loopback interface.
    const MARK: usize = 6;
    const UDP: usize = ETHERNET + 20;
    const PORTS: std::ops::Range<u16> = 7411..7431;
    let Some(udp) = frame.get(UDP..UDP + 8) else { return false };
    let port = u16::from_be_bytes([udp[2], udp[3]]);
    let is_udp = frame[12..14] == [8, 0] && i32::from(frame[ETHERNET + 9]) == libc::IPPROTO_UDP;
    if !is_udp || frame[MARK] != 0 || !PORTS.contains(&port) || port % 2 == 0 {
        return false;
    }
    frame[MARK] = 2;
    // No checksum: on loopback, the kernel leaves the checksum to a forwarder.
    frame[UDP + 6..UDP + 8].fill(0);
    true
}
