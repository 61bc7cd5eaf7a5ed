//! The ROS software of the table: how each starts a talker, a server, an action or a node with
//! parameters, in a graph of its own.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};

use anyhow::{Result, ensure};
use gdp_tests::process::Process;
use gdp_tests::programs::{Executable as _, Program, own};

/// A row of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Software {
    Jazzy,
    Kilted,
    Cyclone,
    Dust,
    Rospy,
    Roscpp,
}

impl Software {
    pub const ALL: [Self; 6] = [Self::Jazzy, Self::Kilted, Self::Cyclone, Self::Dust, Self::Rospy, Self::Roscpp];

    /// The name of the row in the report.
    pub fn label(self) -> &'static str {
        match self {
            Self::Jazzy => "jazzy",
            Self::Kilted => "kilted",
            Self::Cyclone => "cyclone",
            Self::Dust => "dust_dds",
            Self::Rospy => "rospy",
            Self::Roscpp => "roscpp",
        }
    }

    pub fn is_ros1(self) -> bool {
        matches!(self, Self::Rospy | Self::Roscpp)
    }
}

/// Programs of one software, at one end.
pub struct End<'a> {
    pub software: Software,
    /// The DDS domain, if it is software of ROS 2.
    pub domain: u16,
    /// The port of the master, if it is software of ROS 1.
    pub master: u16,
    /// Receives what the programs print.
    pub folder: &'a Path,
}

impl End<'_> {
    /// A talker or listener of strings, with the options of `tests/peers/README.md`.
    pub fn topic(&self, verb: &str, topic: &str, options: &[&str]) -> Result<Process> {
        let mut command = match self.software {
            Software::Jazzy | Software::Kilted => self.rclpy("tests/peers/rclpy_topic.py")?,
            Software::Cyclone => self.wheel("venv", "tests/peers/cyclone.py")?,
            Software::Dust => self.wheel("venv", "tests/peers/dust.py")?,
            Software::Rospy => self.debian("tests/peers/rospy_topic.py")?,
            Software::Roscpp => self.ros1(own(compiled("roscpp-peer")?)),
        };
        command.arg(verb);
        match self.software {
            Software::Cyclone | Software::Dust => {
                command.args(["--topic", &format!("rt{topic}"), "--domain", &self.domain.to_string()])
            }
            _ => command.args(["--topic", topic]),
        };
        self.spawn(verb, command.args(options))
    }

    /// A server (`switch`) or a client (`set`) of a lamp.
    pub fn service(&self, verb: &str, service: &str) -> Result<Process> {
        let mut command = match self.software {
            Software::Jazzy | Software::Kilted => self.rclpy("tests/peers/rclpy_service.py")?,
            Software::Cyclone => self.wheel("venv", "tests/peers/cyclone_service.py")?,
            Software::Rospy => self.debian("tests/peers/rospy_service.py")?,
            Software::Roscpp => self.ros1(own(compiled("roscpp-peer")?)),
            Software::Dust => unreachable!("its row says that it has no services"),
        };
        command.args([verb, "--service", service]);
        if self.software == Software::Cyclone {
            command.args(["--domain", &self.domain.to_string()]);
        }
        self.spawn(verb, &mut command)
    }

    /// A server (`compute`) or a client (`send`) of an action, with the seconds or the order.
    pub fn action(&self, verb: &str, action: &str, argument: &str) -> Result<Process> {
        let name = unique(verb);
        let mut command = match self.software {
            Software::Rospy => {
                let mut command = self.debian("crates/gdp-ros1/tests/rospy/peer.py")?;
                command.args([&name, verb, action, "test_msgs", argument]);
                command
            }
            Software::Roscpp => {
                let mut command = self.ros1(own(compiled("actionlib-peer")?));
                command.args([&name, verb, action, argument]);
                command
            }
            _ => {
                let mut command = self.rclpy("gdp-proxy/tests/calls/peer.py")?;
                command.args([&name, verb, action, argument]);
                command
            }
        };
        self.spawn(verb, &mut command)
    }

    /// Reads the parameters of a node.
    pub fn parameters(&self, node: &str) -> Result<Process> {
        let mut command = self.rclpy("tests/peers/rclpy_graph.py")?;
        self.spawn("parameters", command.arg(node))
    }

    fn rclpy(&self, script: &str) -> Result<Command> {
        let environment = if self.software == Software::Jazzy { "venv-jazzy" } else { "venv" };
        let mut command = self.wheel(environment, script)?;
        // UDP alone: two Fast DDS programs on one machine would otherwise communicate through
        // shared memory.
        command.env("ROS_DOMAIN_ID", self.domain.to_string()).env("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4");
        command.env("ROS_LOG_DIR", self.folder);
        Ok(command)
    }

    fn wheel(&self, environment: &str, script: &str) -> Result<Command> {
        let python = target().join(environment).join("bin/python");
        ensure!(python.is_file(), "{} does not exist: run `cargo xtask setup`", python.display());
        let mut command = own(python);
        command.arg(source(script));
        Ok(command)
    }

    fn debian(&self, script: &str) -> Result<Command> {
        let mut command = Program::Python3.command();
        command.arg(source(script));
        Ok(self.ros1(command))
    }

    fn ros1(&self, mut command: Command) -> Command {
        command.env("ROS_MASTER_URI", format!("http://localhost:{}", self.master)).env("ROS_HOSTNAME", "localhost");
        command.env_remove("ROS_IP").env("ROS_HOME", self.folder).env("ROS_LOG_DIR", self.folder);
        command
    }

    fn spawn(&self, verb: &str, command: &mut Command) -> Result<Process> {
        let command = std::mem::replace(command, own("/nonexistent"));
        Process::spawn(&unique(&format!("{}-{verb}", self.software.label())), command, self.folder)
    }
}

/// Programs of the same kind have other names, as nodes of ROS 1 must.
fn unique(name: &str) -> String {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    format!("{}_{}", name, COUNT.fetch_add(1, Ordering::Relaxed))
}

fn compiled(program: &str) -> Result<PathBuf> {
    let path = target().join("peers").join(program);
    ensure!(path.is_file(), "{} does not exist: run `cargo xtask test`", path.display());
    Ok(path)
}

fn source(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path)
}

/// Cargo's target folder: this test is in `target/PROFILE/deps`.
fn target() -> PathBuf {
    std::env::current_exe().unwrap().ancestors().nth(3).unwrap().into()
}
