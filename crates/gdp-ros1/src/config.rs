//! The configuration of a node: the address of its master, its own address, and its limits.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};
use std::time::Duration;

/// The configuration of a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeConfig {
    /// The global name, such as `/gdp_proxy`. If a second node registers the same name, the master
    /// sends `shutdown` to the first.
    pub name: String,
    /// The URI of the master, such as `http://localhost:11311/`.
    pub master_uri: String,
    /// The host that other nodes connect to: a resolvable host name or an address.
    pub host: String,
    /// The address on which the slave API and TCPROS listen. The system chooses both ports.
    pub bind: IpAddr,
    /// The interval between two polls of the master's state, which detect lost registrations and
    /// update the graph. It is clamped to 50 ms to 60 s.
    pub poll: Duration,
    /// The timeout of each call to the master or to another node's slave API, and of each
    /// handshake.
    pub timeout: Duration,
    /// Maximum size of a message, request or response, in bytes.
    pub max_message: usize,
}

/// The default port of roscore.
const MASTER_PORT: u16 = 11311;

impl NodeConfig {
    /// Reads the configuration from the environment, like every ROS 1 node. The variables are
    /// `ROS_MASTER_URI` and `ROS_IPV6`, and for the host `ROS_HOSTNAME`, then `ROS_IP`, then the
    /// host name of this machine. The node listens only on loopback if the host is a loopback
    /// address.
    pub fn from_env(name: &str) -> Self {
        Self::on_this_machine(name, |variable| std::env::var(variable).ok())
    }

    /// Reads the configuration from variables that need not be in the environment.
    pub fn on_this_machine(name: &str, variable: impl Fn(&str) -> Option<String>) -> Self {
        let machine = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
        Self::from_variables(name, variable, machine.trim())
    }

    /// Reads the configuration from variables. `machine` is the host name of this machine.
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

    /// Returns an address of this node as `SCHEME://HOST:PORT`.
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
