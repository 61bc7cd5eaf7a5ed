//! Topics between a robot and a cloud: their names and rights, and the proxies that carry them.

use std::path::Path;
use std::process::Command;

use anyhow::Result;
use serde_json::{Value, json};

use crate::fabric::{Authority, write_yaml};
use crate::netns::Namespace;
use crate::process::Process;
use crate::tools::Tools;

/// A ROS topic that crosses a fabric in one direction.
#[derive(Clone, Copy, Debug)]
pub struct FabricTopic {
    pub topic: &'static str,
    /// Its ROS type, such as `sensor_msgs/msg/Image`.
    pub kind: &'static str,
    /// Whether the robot publishes it. Otherwise the cloud does.
    pub from_robot: bool,
    /// Whether the cloud has it in ROS 1, at [`MASTER`].
    pub in_ros1: bool,
}

impl FabricTopic {
    /// Returns the stem of the topic's files: its card and the certificates of its two ends.
    pub fn stem(&self) -> String {
        self.topic.trim_start_matches('/').replace('/', "_")
    }

    /// Returns an end's entry of `topics` in the configuration of its proxy.
    pub fn entry(&self, publishes: bool) -> Value {
        let (direction, right) = if publishes { ("out", "cert") } else { ("in", "grant") };
        let stem = self.stem();
        json!({
            "topic": self.topic, "type": self.kind, "direction": direction,
            "card": format!("{stem}.card"), (right): format!("{stem}.cert"),
            "qos": {"reliability": "reliable", "durability": "volatile", "depth": DEPTH},
        })
    }
}

/// The ROS 1 master of the cloud.
pub const MASTER: &str = "http://localhost:11311";

/// Names of the cloud's graphs.
const ROS1: &str = "ros1";
const ROS2: &str = "ros2";

/// Returns the graphs of a proxy that is in ROS 2 alone.
pub fn ros2() -> Value {
    json!({(ROS2): {"domain_id": 0}})
}

/// What the proxies of robot and cloud are told of their topics: entries of `topics` in the
/// configuration.
pub struct BothEnds {
    pub robot: Vec<Value>,
    pub cloud: Vec<Value>,
    /// The ROS graphs of the cloud.
    pub cloud_graphs: Value,
}

/// KEEP_LAST of a topic, in messages.
const DEPTH: u32 = 10;

impl Authority<'_> {
    /// Creates a name for each topic, with rights for robot and cloud, whose keys exist. `scope`:
    /// trust domains in which the topics may be published; none without domains.
    pub fn topics(&self, topics: &[FabricTopic], scope: &[&str]) -> Result<BothEnds> {
        let mut both = BothEnds { robot: Vec::new(), cloud: Vec::new(), cloud_graphs: ros2() };
        let publish: Vec<&str> =
            ["--publish"].into_iter().chain(scope.iter().flat_map(|domain| ["--scope", domain])).collect();
        let has_ros1 = topics.iter().any(|topic| topic.in_ros1);
        for it @ FabricTopic { topic, kind, from_robot, in_ros1 } in topics {
            let file = it.stem();
            self.name("topic", topic, kind, &format!("{file}.card"))?;
            for (label, entries, publishes) in
                [("robot", &mut both.robot, *from_robot), ("cloud", &mut both.cloud, !*from_robot)]
            {
                let rights = if publishes { &publish[..] } else { &["--read"][..] };
                self.hand(label, &self.name_of(label)?, rights, &file)?;
                let mut entry = it.entry(publishes);
                if has_ros1 && label == "cloud" {
                    entry["graph"] = json!(if *in_ros1 { ROS1 } else { ROS2 });
                }
                entries.push(entry);
            }
        }
        if has_ros1 {
            both.cloud_graphs = json!({(ROS2): {"domain_id": 0}, (ROS1): {"master": MASTER}});
        }
        Ok(both)
    }
}

/// The configuration of a proxy whose files are in the folder of its label.
pub struct ProxyPlan<'a> {
    /// Switches to attach to, such as `eth://r0`.
    pub links: Vec<&'a str>,
    /// The ROS graphs, such as [`ros2`].
    pub graphs: Value,
    pub topics: Vec<Value>,
    /// Peering certificates of a member of a trust domain.
    pub peers: Option<&'a [&'a str]>,
}

impl ProxyPlan<'_> {
    /// Starts `gdp-proxy` with this configuration. It writes its statistics to `stats.json`.
    /// `files`: the parent of the proxy's folder, and the place of its output.
    pub fn start(self, tools: &Tools, at: &Namespace, files: &Path, label: &str) -> Result<Process> {
        Process::spawn(&format!("{label}-proxy"), self.command(tools, at, files, label)?, files)
    }

    /// Writes the configuration, and returns the command that [`ProxyPlan::start`] starts.
    pub fn command(self, tools: &Tools, at: &Namespace, files: &Path, label: &str) -> Result<Command> {
        let folder = files.join(label);
        let mut config = json!({
            "identity": "key.pem",
            "links": self.links.iter().map(|to| json!({"to": to})).collect::<Vec<_>>(),
            "version": 1,
            "graphs": self.graphs,
            "topics": self.topics,
        });
        if let Some(peers) = self.peers {
            config["domain"] = json!({"card": "domain.card", "membership": "membership", "peers": peers});
        }
        let path = folder.join("proxy.yaml");
        write_yaml(&path, &config)?;
        let mut command = at.command(tools.gdp_proxy()?)?;
        command.arg("--config").arg(path).arg("--stats").arg(folder.join("stats.json"));
        Ok(command)
    }
}
