//! Programs of twelve lines in Rust and Python, and nodes of rclpy, by way of a proxy.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use gdp_tests::dds_domain::lease;
use gdp_tests::programs::own;
use tokio::io::{AsyncBufReadExt as _, BufReader, Lines};
use tokio::process::{Child, ChildStdout};

use crate::installed::{environment, existing, profile};
use crate::site::{Entity, Site};

const TIMEOUT: Duration = Duration::from_secs(60);

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn programs_in_rust_and_python_talk_to_a_listener_of_ros() {
    let site = Site::new().await;
    let (in_rust, in_python, proxy) = (site.keyring("rust"), site.keyring("python"), site.keyring("proxy"));
    site.allow(&site.card("topic", "/chatter", "std_msgs/msg/String"), &[&in_rust, &in_python], &[&proxy]);
    let domain = lease();
    let mut proxy =
        site.proxy(&proxy, domain, "{topic: /chatter, card: chatter.card, grant: chatter.grant, direction: in}");
    let mut listener = Program::start(site.node(domain, "listen"));

    let mut talker = Program::start(site.sdk(own(example("ros_talker")), &in_rust));
    listener.line(&mut [&mut proxy, &mut talker], |line| line.starts_with("hello") && !line.contains("Python")).await;
    drop(talker);
    let mut talker = site.python();
    talker.arg(concat!(env!("CARGO_MANIFEST_DIR"), "/examples/ros_talker.py"));
    let mut talker = Program::start(site.sdk(talker, &in_python));
    listener
        .line(&mut [&mut proxy, &mut talker], |line| line.starts_with("hello") && line.ends_with("from Python"))
        .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn programs_in_rust_and_python_listen_to_a_talker_of_ros() {
    let site = Site::new().await;
    let (in_rust, in_python, proxy) = (site.keyring("rust"), site.keyring("python"), site.keyring("proxy"));
    site.allow(&site.card("topic", "/chatter", "std_msgs/msg/String"), &[&proxy], &[&in_rust, &in_python]);
    let domain = lease();
    let mut proxy =
        site.proxy(&proxy, domain, "{topic: /chatter, card: chatter.card, cert: chatter.ad, direction: out}");
    let mut talker = Program::start(site.node(domain, "talk"));

    let mut listener = Program::start(site.sdk(own(example("ros_listener")), &in_rust));
    listener.line(&mut [&mut proxy, &mut talker], |line| line == "hello from ROS").await;
    let mut listener = site.python();
    listener.arg(concat!(env!("CARGO_MANIFEST_DIR"), "/examples/ros_listener.py"));
    let mut listener = Program::start(site.sdk(listener, &in_python));
    listener.line(&mut [&mut proxy, &mut talker], |line| line == "hello from ROS").await;
}

impl Site {
    /// A proxy with one topic, in a DDS domain.
    fn proxy(&self, entity: &Entity, domain: u16, topic: &str) -> Program {
        let config = format!(
            "version: 1\nidentity: id.pem\nlinks: [{{to: '{}'}}]\ngraphs: {{a: {{domain_id: {domain}}}}}\ntopics:\n  - {topic}\n",
            self.switch()
        );
        let file = entity.folder.join("proxy.yaml");
        std::fs::write(&file, config).unwrap();
        let mut command = own(existing(profile().join("gdp-proxy"), "cargo build -p gdp-proxy"));
        command.arg("--config").arg(file);
        Program::start(command)
    }

    /// A node of rclpy.
    fn node(&self, domain: u16, verb: &str) -> Command {
        let mut command = own(environment("venv"));
        command.arg(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/ros_node.py")).args([verb, "/chatter"]);
        command.env("ROS_DOMAIN_ID", domain.to_string()).env("ROS_LOG_DIR", std::env::temp_dir());
        // UDP alone, as the proxy does.
        command.env("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4");
        command
    }

    /// A program of the SDK with this keyring.
    fn sdk(&self, mut command: Command, entity: &Entity) -> Command {
        command.env("GDP_KEYRING", &entity.folder).env("GDP_SWITCH", self.switch());
        command
    }
}

fn example(name: &str) -> impl AsRef<Path> {
    existing(profile().join("examples").join(name), "cargo build -p gdp-ros --examples")
}

/// A running program, until it is dropped.
struct Program {
    child: Child,
    output: Lines<BufReader<ChildStdout>>,
}

impl Program {
    fn start(command: Command) -> Self {
        let mut command = tokio::process::Command::from(command);
        let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).kill_on_drop(true).spawn().unwrap();
        let output = BufReader::new(child.stdout.take().unwrap()).lines();
        Self { child, output }
    }

    /// Waits for a line of its output. Fails at once if one of the others ends.
    async fn line(&mut self, others: &mut [&mut Self], is_it: impl Fn(&str) -> bool) {
        let found = async {
            loop {
                let line = self.output.next_line().await.unwrap().expect("the program ended");
                if is_it(&line) {
                    return;
                }
            }
        };
        let ended = futures::future::select_all(others.iter_mut().map(|other| Box::pin(other.child.wait())));
        tokio::select! {
            found = tokio::time::timeout(TIMEOUT, found) => found.expect("a line in time"),
            (status, which, _) = ended => panic!("program {which} in the background ended: {status:?}"),
        }
    }
}
