//! The programs of `tests/peers`, started and listened to.

use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;

use gdp_tests::programs::own;
use serde_json::Value;
use tokio::io::{AsyncBufReadExt, BufReader, Lines};
use tokio::process::{Child, ChildStdout, Command};

pub const SERVICE: &str = "/add_two_ints";
pub const LAMP: &str = "/lamp";

#[derive(Clone, Copy, Debug)]
pub enum Vendor {
    Cyclone,
    FastDds,
    /// Fast DDS 3, beneath Kilted's rclpy.
    Rclpy,
    /// Fast DDS 2.14, beneath Jazzy's rclpy.
    Jazzy,
    /// Has no services.
    Dust,
}

impl Vendor {
    pub const ALL: [Self; 5] = [Self::Cyclone, Self::FastDds, Self::Rclpy, Self::Jazzy, Self::Dust];
}

/// A running program, until it is dropped.
pub struct Peer {
    child: Child,
    output: Lines<BufReader<ChildStdout>>,
}

impl Peer {
    /// A talker or listener of `/chatter`.
    pub fn topic(vendor: Vendor, verb: &str, domain: u16, options: &[&str]) -> Self {
        let mut command = match vendor {
            Vendor::Cyclone => python("cyclone.py"),
            Vendor::Dust => python("dust.py"),
            Vendor::FastDds => compiled("fastdds-peer"),
            Vendor::Rclpy | Vendor::Jazzy => {
                let mut command = rclpy(vendor, "rclpy_topic.py", domain);
                command.arg(verb).args(options);
                return Self::start(command);
            }
        };
        command.arg(verb).args(["--domain", &domain.to_string()]).args(options);
        Self::start(command)
    }

    /// Shows the graph as rclpy sees it, and before the parameters of a node, if one is named.
    pub fn graph(domain: u16, node: Option<&str>) -> Self {
        Self::rclpy("rclpy_graph.py", domain, node.as_slice())
    }

    /// A program with rclpy.
    pub fn rclpy(script: &str, domain: u16, arguments: &[&str]) -> Self {
        let mut command = rclpy(Vendor::Rclpy, script, domain);
        command.args(arguments);
        Self::start(command)
    }

    /// A program of `tests/peers` in Python.
    pub fn python(script: &str, arguments: &[&str]) -> Self {
        let mut command = python(script);
        command.args(arguments);
        Self::start(command)
    }

    /// A server or client of `std_srvs/srv/SetBool`, of rclpy.
    pub fn rclpy_service(verb: &str, domain: u16, service: &str) -> Self {
        let mut command = rclpy(Vendor::Rclpy, "rclpy_service.py", domain);
        command.args([verb, "--service", service]);
        Self::start(command)
    }

    /// A node of the tests of services and actions, of rclpy.
    pub fn rclpy_action(domain: u16, arguments: &[&str]) -> Self {
        let mut command = rclpy(Vendor::Rclpy, "../../gdp-proxy/tests/calls/peer.py", domain);
        command.args(arguments);
        Self::start(command)
    }

    /// A server that adds two integers.
    pub fn serve(vendor: Vendor, domain: u16) -> Self {
        Self::service(vendor, "serve", domain, &[])
    }

    /// A client that has two integers added, and says what came of it.
    pub fn call(vendor: Vendor, domain: u16, a: i64, b: i64) -> Self {
        Self::service(vendor, "call", domain, &[a, b])
    }

    /// A node of rclpy that serves (`switch`) or calls (`set`) a `std_srvs/srv/SetBool`.
    pub fn lamp(vendor: Vendor, verb: &str, domain: u16) -> Self {
        let mut command = rclpy(vendor, "rclpy_service.py", domain);
        command.args([verb, "--service", LAMP]);
        Self::start(command)
    }

    fn service(vendor: Vendor, verb: &str, domain: u16, numbers: &[i64]) -> Self {
        let (domain, numbers) = (domain.to_string(), numbers.iter().map(i64::to_string));
        let command = match vendor {
            Vendor::Cyclone => {
                let mut command = python("cyclone_service.py");
                command.args([verb, "--domain", &domain, "--service", SERVICE]);
                for (flag, number) in ["--a", "--b"].into_iter().zip(numbers) {
                    command.args([flag, &number]);
                }
                command
            }
            Vendor::Rclpy | Vendor::Jazzy | Vendor::Dust => unreachable!("it has no service of this type"),
            Vendor::FastDds => {
                let mut command = compiled("fastdds-service-peer");
                command.args([verb, &domain, SERVICE]).args(numbers);
                command
            }
        };
        Self::start(command)
    }

    fn start(mut command: Command) -> Self {
        let mut child = command.stdout(Stdio::piped()).kill_on_drop(true).spawn().unwrap();
        let output = BufReader::new(child.stdout.take().unwrap()).lines();
        Self { child, output }
    }

    /// The next line with this event.
    pub async fn event(&mut self, event: &str) -> Value {
        within(event, async {
            loop {
                let line = self.output.next_line().await.unwrap().expect("the program ended");
                let line: Value = serde_json::from_str(&line).unwrap();
                if line["event"] == event {
                    return line;
                }
            }
        })
        .await
    }

    /// The next message that is not one of the warm-up.
    pub async fn message(&mut self) -> Value {
        loop {
            let message = self.event("message").await;
            if message["seq"] != -1 {
                return message;
            }
        }
    }

    pub async fn hears_within(&mut self, limit: Duration) -> bool {
        tokio::time::timeout(limit, self.event("message")).await.is_ok()
    }

    pub fn signal(&self, signal: libc::c_int) {
        let pid = self.child.id().expect("it runs") as libc::pid_t;
        // SAFETY: no pointers; the child is ours and not reaped yet.
        assert_eq!(unsafe { libc::kill(pid, signal) }, 0);
    }

    /// Ends it without a goodbye.
    pub async fn kill(mut self) {
        self.child.kill().await.unwrap();
    }
}

pub async fn within<T>(what: &str, future: impl Future<Output = T>) -> T {
    tokio::time::timeout(Duration::from_secs(60), future).await.unwrap_or_else(|_| panic!("not in 60 s: {what}"))
}

fn python(script: &str) -> Command {
    python_in("venv", script)
}

/// A script, run by the Python of an environment.
fn python_in(environment: &str, script: &str) -> Command {
    let python = target().join(environment).join("bin/python");
    let mut command = Command::from(own(existing(python, "cargo xtask setup")));
    command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/peers").join(script));
    command
}

fn rclpy(vendor: Vendor, script: &str, domain: u16) -> Command {
    let mut command = python_in(if matches!(vendor, Vendor::Jazzy) { "venv-jazzy" } else { "venv" }, script);
    command.env("ROS_DOMAIN_ID", domain.to_string()).env("ROS_LOG_DIR", std::env::temp_dir());
    // UDP alone: two Fast DDS programs on one machine would otherwise communicate through shared
    // memory.
    command.env("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4");
    command
}

fn compiled(program: &str) -> Command {
    Command::from(own(existing(target().join("peers").join(program), "cargo xtask test")))
}

/// Cargo's target folder: this test is in `target/PROFILE/deps`.
pub fn target() -> PathBuf {
    std::env::current_exe().unwrap().ancestors().nth(3).unwrap().into()
}

fn existing(file: PathBuf, remedy: &str) -> PathBuf {
    assert!(file.is_file(), "{} does not exist: run `{remedy}`", file.display());
    file
}
