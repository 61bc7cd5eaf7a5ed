//! The foreign programs of `tests/peers`, at either end of a chain: DDS, and for comparison TCP and
//! QUIC.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use anyhow::{Context, Result};
use serde_json::Value;

use crate::netns::Namespace;
use crate::process::Process;
use crate::tools::Tools;
use crate::wait::check_interrupt;

/// The DDS implementation of a program, or a connection to the listener at [`Traffic::peer`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Vendor {
    Cyclone,
    FastDds,
    /// A TCP connection, with [`Traffic::tls`] or in clear.
    Tcp,
    /// QUIC, with a stream for each topic. Needs [`Traffic::tls`].
    Quic,
    /// QUIC, with a stream for each message. Needs [`Traffic::tls`].
    QuicStreams,
}

/// The messages of a talker, and the QoS of both ends.
#[derive(Clone, Debug)]
pub struct Traffic {
    /// Number of messages; 0: until killed.
    pub count: u64,
    /// Messages per second.
    pub rate: f64,
    /// Bytes of the string in a message.
    pub size: usize,
    /// The text that the string repeats.
    pub text: String,
    pub best_effort: bool,
    pub transient_local: bool,
    pub depth: u32,
    /// Discovers this address by unicast, and nothing by multicast.
    pub peer: Option<String>,
    /// Uses `lo` alone, as on a robot whose other interfaces are unstable. Cyclone DDS only.
    pub on_loopback: bool,
    /// Number of topics, used in turn. All names but the first have their number appended. Fast DDS
    /// and QUIC only.
    pub topics: u32,
    /// Announces a ROS node of this name, which some bridges require. Cyclone DDS only.
    pub node: Option<String>,
    /// TCP and QUIC only.
    pub tls: Option<Tls>,
    /// Turns on DDS Security with the files in this folder. Fast DDS only.
    pub security: Option<PathBuf>,
}

/// The listener's key, and its certificate, which the talker trusts. Both are PEM files.
#[derive(Clone, Debug)]
pub struct Tls {
    pub key: PathBuf,
    pub certificate: PathBuf,
}

/// Configuration that restricts Cyclone DDS to `lo`.
pub const ON_LOOPBACK: &str = "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name=\"lo\" \
                               multicast=\"true\"/></Interfaces>\
                           </General></Domain></CycloneDDS>";

impl Default for Traffic {
    fn default() -> Self {
        Self {
            count: 0,
            rate: 20.0,
            size: 64,
            text: "hello from the robot".into(),
            best_effort: false,
            transient_local: false,
            depth: 10,
            peer: None,
            on_loopback: false,
            topics: 1,
            node: None,
            tls: None,
            security: None,
        }
    }
}

/// A message as the listener received it.
#[derive(Clone, Copy, Debug)]
pub struct Received {
    pub sequence: i64,
    /// Time from the talker's `write` to the listener's callback.
    pub latency: Duration,
    pub bytes: u64,
    /// Whether the content equals what the talker sent.
    pub intact: bool,
}

/// A talker and a listener, and the messages between them.
pub struct Conversation {
    pub talker: Process,
    pub listener: Process,
    gate: PathBuf,
    count: u64,
    topics: u32,
}

impl Conversation {
    /// Starts both and waits until warm-up messages arrive on every topic. Every later message
    /// counts. `folder` receives the output of both.
    pub fn start(tools: &Tools, talks: Side, hears: Side, folder: &Path) -> Result<Self> {
        let listener = listener(tools, hears.at, hears.vendor, hears.traffic, folder)?;
        let gate = folder.join("gate");
        let mut command = talk_command(tools, talks.at, talks.vendor, talks.traffic)?;
        command.arg("--gate").arg(&gate);
        let talker = Process::spawn("talker", command, folder)?;
        let Traffic { count, topics, .. } = *talks.traffic;
        let mut this = Self { talker, listener, gate, count, topics };
        this.listener.wait_until("a first message", Duration::from_secs(30), |p| {
            let lines = p.json_lines();
            let messages = lines.iter().filter(|line| line["event"] == "message");
            let heard: BTreeSet<_> = messages.map(|line| line["topic"].as_u64()).collect();
            (heard.len() >= topics as usize).then_some(())
        })?;
        Ok(this)
    }

    /// Lets the talker send the messages that count.
    pub fn open(&self) -> Result<()> {
        std::fs::write(&self.gate, "").with_context(|| format!("cannot write {}", self.gate.display()))
    }

    /// Waits until the talker has sent all messages and the last one has arrived. Gives up on the
    /// last one after `limit` more.
    pub fn finish(&mut self, sending: Duration, limit: Duration) -> Result<Vec<Received>> {
        self.talker.wait_event("done", sending + limit)?;
        let (last, all) = (self.count as i64 - 1, self.count as usize);
        // Messages of different topics can overtake one another.
        let is_over = |messages: &[Received]| match self.topics {
            1 => messages.iter().any(|message| message.sequence == last),
            _ => messages.len() >= all,
        };
        let arrived = |p: &Process| is_over(&received(p)).then_some(());
        let waited = self.listener.wait_until("the last message", limit, arrived);
        check_interrupt()?;
        self.listener.check_alive()?;
        if waited.is_err() {
            eprintln!("the last message did not arrive");
        }
        Ok(received(&self.listener))
    }
}

/// One end of a conversation.
#[derive(Clone, Copy)]
pub struct Side<'a> {
    pub at: &'a Namespace,
    pub vendor: Vendor,
    pub traffic: &'a Traffic,
}

/// Starts a talker that sends at once, without waiting for a listener.
pub fn talker(tools: &Tools, at: &Namespace, vendor: Vendor, traffic: &Traffic, logs: &Path) -> Result<Process> {
    Process::spawn("talker", talk_command(tools, at, vendor, traffic)?, logs)
}

pub fn listener(tools: &Tools, at: &Namespace, vendor: Vendor, traffic: &Traffic, logs: &Path) -> Result<Process> {
    Process::spawn("listener", program(tools, at, vendor, "listen", traffic)?, logs)
}

/// Returns all messages that a listener has reported so far, without warm-up messages.
pub fn received(listener: &Process) -> Vec<Received> {
    listener.json_lines().iter().filter_map(parse).filter(|message| message.sequence >= 0).collect()
}

/// Returns the value below which `percent` of `sorted` lie.
pub fn percentile(sorted: &[Duration], percent: f64) -> Duration {
    let rank = (sorted.len() as f64 * percent / 100.0).ceil() as usize;
    sorted.get(rank.max(1).min(sorted.len()).wrapping_sub(1)).copied().unwrap_or_default()
}

fn parse(line: &Value) -> Option<Received> {
    (line["event"] == "message").then_some(())?;
    Some(Received {
        sequence: line["seq"].as_i64()?,
        latency: Duration::from_nanos(line["latency_ns"].as_i64()?.try_into().unwrap_or(0)),
        bytes: line["bytes"].as_u64()?,
        intact: line["intact"].as_bool()?,
    })
}

fn talk_command(tools: &Tools, at: &Namespace, vendor: Vendor, traffic: &Traffic) -> Result<Command> {
    let mut command = program(tools, at, vendor, "talk", traffic)?;
    command.args(["--count", &traffic.count.to_string(), "--rate", &traffic.rate.to_string()]);
    command.args(["--size", &traffic.size.to_string(), "--text", &traffic.text]);
    Ok(command)
}

fn program(tools: &Tools, at: &Namespace, vendor: Vendor, verb: &str, traffic: &Traffic) -> Result<Command> {
    let mut command = match vendor {
        Vendor::FastDds => at.command(tools.fastdds()?)?,
        Vendor::Cyclone => {
            let mut python = at.command(tools.python()?)?;
            python.arg(tools.cyclone());
            if traffic.on_loopback {
                python.env("CYCLONEDDS_URI", ON_LOOPBACK);
            }
            python
        }
        Vendor::Tcp => {
            let mut python = at.command(tools.python()?)?;
            python.arg(tools.peer("tcp.py"));
            python
        }
        Vendor::Quic | Vendor::QuicStreams => at.command(tools.quic()?)?,
    };
    command.arg(verb).args(["--depth", &traffic.depth.to_string()]);
    for (wanted, flag) in [(traffic.best_effort, "--best-effort"), (traffic.transient_local, "--transient-local")] {
        if wanted {
            command.arg(flag);
        }
    }
    if let Some(peer) = &traffic.peer {
        command.args(["--peer", peer]);
    }
    if traffic.topics > 1 {
        command.args(["--topics", &traffic.topics.to_string()]);
    }
    if vendor == Vendor::QuicStreams {
        command.arg("--stream-each");
    }
    if let Some(Tls { key, certificate }) = &traffic.tls {
        command.arg("--key").arg(key).arg("--certificate").arg(certificate);
    }
    if let Some(folder) = &traffic.security {
        command.arg("--security").arg(folder);
    }
    if let Some(node) = &traffic.node {
        command.args(["--node", node]);
    }
    Ok(command)
}
