//! The section `etcd` of the configuration: where replicas of a RIB keep together what they know.

use serde::Deserialize;

use crate::store::Endpoint;

/// Members of an etcd cluster; they are three or five.
const MAX_ENDPOINTS: usize = 16;

/// Bytes of the prefix.
const MAX_PREFIX: usize = 128;

/// Where replicas of a RIB keep what they know.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EtcdConfig {
    /// Of the members of one cluster.
    pub endpoints: Vec<Endpoint>,
    /// What all keys begin with: the same for the replicas of one domain, another for those of any
    /// other.
    pub prefix: String,
}

/// As it is written.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct EtcdEntry {
    endpoints: Vec<String>,
    #[serde(default = "default_prefix")]
    prefix: String,
}

fn default_prefix() -> String {
    "gdp/rib".into()
}

impl EtcdEntry {
    /// `rib`: whether this daemon is a RIB.
    pub fn check(self, rib: bool) -> Result<EtcdConfig, String> {
        if !rib {
            return Err("etcd: it keeps what replicas of the RIB know, and this daemon is none; remove it, or rib: \
                        false and uplink"
                .into());
        }
        let mut endpoints = Vec::new();
        for text in &self.endpoints {
            let endpoint: Endpoint = text.parse().map_err(|reason| format!("etcd: {reason}"))?;
            if endpoints.contains(&endpoint) {
                return Err(format!("etcd: {endpoint} is listed twice"));
            }
            endpoints.push(endpoint);
        }
        if !(1..=MAX_ENDPOINTS).contains(&endpoints.len()) {
            return Err(format!("etcd: {} endpoints, where 1 to {MAX_ENDPOINTS} are listed", endpoints.len()));
        }
        let prefix = self.prefix;
        let is_plain = prefix.chars().all(|c| c.is_ascii_graphic());
        if !is_plain || prefix.len() > MAX_PREFIX || prefix.split('/').any(str::is_empty) {
            return Err(format!(
                "etcd: the prefix {prefix:?} is not one to {MAX_PREFIX} visible characters, without a slash at its \
                 ends, such as gdp/rib"
            ));
        }
        Ok(EtcdConfig { endpoints, prefix })
    }
}
