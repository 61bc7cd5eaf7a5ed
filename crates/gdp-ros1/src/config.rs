//! The configuration of a node: the address of its master, its own address, and its limits.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};
use std::time::Duration;

/// How a node is set up.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeConfig {
    /// In full, such as `/gdp_proxy`. Of two nodes with the same name at a master, the one that
    /// came first is told to end.
    pub name: String,
    /// Such as `http://localhost:11311/`.
    pub master_uri: String,
    /// What others are told to connect to: a host name that they can resolve, or an address.
    pub host: String,
    /// Where this node takes connections, both those of the slave API and of TCPROS, at ports that
    /// the system chooses.
    pub bind: IpAddr,
    /// How often the master is asked for its state: to find out that it has forgotten this node,
    /// and what there is. Taken as 50 ms to 60 s.
    pub poll: Duration,
    /// For each call of the master or another node's slave API, and for each handshake.
    pub timeout: Duration,
    /// Of one message, request or response, in bytes.
    pub max_message: usize,
}

/// roscore's own.
const MASTER_PORT: u16 = 11311;

impl NodeConfig {
    /// As the environment says, like every ROS 1 node: `ROS_MASTER_URI`, then `ROS_HOSTNAME` before
    /// `ROS_IP` before the name of this machine, and `ROS_IPV6`. A host that means this machine
    /// alone is also all that is listened at.
    pub fn from_env(name: &str) -> Self {
        Self::on_this_machine(name, |variable| std::env::var(variable).ok())
    }

    /// The same, with variables that need not be in the environment.
    pub fn on_this_machine(name: &str, variable: impl Fn(&str) -> Option<String>) -> Self {
        let machine = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
        Self::from_variables(name, variable, machine.trim())
    }

    /// As variables say that need not be in the environment. `machine`: its host name.
    pub fn from_variables(name: &str, variable: impl Fn(&str) -> Option<String>, machine: &str) -> Self {
        let set = |name| variable(name).filter(|value| !value.is_empty());
        let machine = if machine.is_empty() { "localhost" } else { machine };
        let host = set("ROS_HOSTNAME").or_else(|| set("ROS_IP")).unwrap_or_else(|| machine.to_owned());
        let bind = match host.parse::<IpAddr>() {
            Ok(address) if address.is_loopback() => address,
            _ if host == "localhost" => Ipv4Addr::LOCALHOST.into(),
            _ if set("ROS_IPV6").is_some_and(|value| value == "on") => Ipv6Addr::UNSPECIFIED.into(),
            _ => Ipv4Addr::UNSPECIFIED.into(),
        };
        Self {
            name: name.to_owned(),
            master_uri: set("ROS_MASTER_URI").unwrap_or_else(|| format!("http://localhost:{MASTER_PORT}/")),
            host,
            bind,
            poll: Duration::from_secs(1),
            timeout: Duration::from_secs(5),
            max_message: 64 << 20,
        }
    }

    /// An address of this node: `SCHEME://HOST:PORT`.
    pub(crate) fn uri(&self, scheme: &str, port: u16) -> String {
        match &self.host {
            host if host.contains(':') => format!("{scheme}://[{host}]:{port}"),
            host => format!("{scheme}://{host}:{port}"),
        }
    }
}

#[cfg(test)]
#[path = "../tests/unit/config.rs"]
mod tests;
