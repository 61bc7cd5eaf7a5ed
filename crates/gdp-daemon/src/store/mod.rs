//! The store of a RIB with several replicas: etcd. A single RIB does not use it.
//!
//! [`client`] talks to etcd. [`items`] maps the items of the RIB to keys, and writes them for the
//! leader. `serve::election` elects the leader.

mod access;
#[cfg_attr(not(feature = "etcd"), path = "without_etcd.rs")]
pub mod client;
pub mod items;
pub mod kv;

use std::fmt;
use std::str::FromStr;

use gdp_core::secret_file::SecretFileError;

pub use self::access::{Access, ClientCertificate, Login, Tls};

/// The address of an etcd member for clients.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// Whether the scheme is `https` instead of `http`.
    pub tls: bool,
    /// A host name, or an address without brackets.
    pub host: String,
    pub port: u16,
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { tls, host, port } = self;
        let scheme = if *tls { "https" } else { "http" };
        if host.contains(':') { write!(f, "{scheme}://[{host}]:{port}") } else { write!(f, "{scheme}://{host}:{port}") }
    }
}

impl FromStr for Endpoint {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("{text:?} is not an endpoint such as https://10.0.0.1:2379 or http://[::1]:2379");
        let (tls, authority) = match text.strip_prefix("https://") {
            Some(authority) => (true, authority),
            None => (false, text.strip_prefix("http://").ok_or_else(wrong)?),
        };
        let authority = authority.strip_suffix('/').unwrap_or(authority);
        let (host, port) = authority.rsplit_once(':').ok_or_else(wrong)?;
        let host = match host.strip_prefix('[') {
            Some(inner) => inner.strip_suffix(']').filter(|ip| ip.parse::<std::net::Ipv6Addr>().is_ok()),
            None => Some(host).filter(|host| is_host_name(host)),
        };
        let port = port.parse().ok().filter(|port| *port > 0).ok_or_else(wrong)?;
        Ok(Self { tls, host: host.ok_or_else(wrong)?.to_owned(), port })
    }
}

fn is_host_name(text: &str) -> bool {
    let is_part_of_one = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '.' | '_');
    (1..=253).contains(&text.len()) && text.chars().all(is_part_of_one)
}

/// The reason why a store operation failed.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    #[error("etcd does not answer at {endpoint}: {reason}")]
    Unreachable { endpoint: Endpoint, reason: String },
    #[error("etcd at {endpoint} refused: {reason}")]
    Refused { endpoint: Endpoint, reason: String },
    #[error("etcd: {0}")]
    File(#[from] SecretFileError),
    #[error(
        "built without etcd: build gdp-ctl with the cargo feature `etcd` (cargo xtask build --etcd), or remove etcd from the configuration"
    )]
    NotBuilt,
    #[error("etcd has let go of the history that was to be followed")]
    Compacted,
    #[error("etcd holds more than the {0} bytes that a RIB takes: look what is under its prefix")]
    TooMuch(usize),
    #[error("another replica leads, or nobody does: the lease of this one is over")]
    Fenced,
    #[error("what is stored changes under the leader: does somebody else write under the prefix?")]
    Contended,
}

#[cfg(test)]
#[path = "../../tests/unit/store.rs"]
mod tests;
