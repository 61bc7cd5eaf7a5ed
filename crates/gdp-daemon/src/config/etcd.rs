//! The section `etcd` of the configuration: the shared store of the RIB's replicas.

use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::Deserialize;

use crate::store::{Access, ClientCertificate, Endpoint, Login, Tls};

/// The maximum number of endpoints. Clusters have three or five members.
const MAX_ENDPOINTS: usize = 16;

/// The maximum length of the prefix, in bytes.
const MAX_PREFIX: usize = 128;

/// The shared store of the RIB's replicas.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EtcdConfig {
    /// The endpoints of the members of one cluster.
    pub endpoints: Vec<Endpoint>,
    /// The prefix of all keys. Replicas of one domain share it; other domains use another.
    pub prefix: String,
    pub access: Access,
}

/// The section `etcd`, in builds with the cargo feature `etcd`.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct EtcdEntry {
    /// The URLs of the members of one etcd cluster, 1 to 16.
    endpoints: Vec<String>,
    /// The prefix of all keys, another one for each domain.
    #[serde(default = "default_prefix")]
    prefix: String,
    /// PEM file of the CA that certifies the members. Endpoints with `https` need it.
    ca: Option<PathBuf>,
    /// PEM file of the client certificate, if etcd demands one.
    cert: Option<PathBuf>,
    /// PEM file of the client certificate's key.
    key: Option<PathBuf>,
    /// The user of etcd, if it has authentication enabled. Only with `https`.
    user: Option<String>,
    /// A file with one line, the user's password.
    password_file: Option<PathBuf>,
}

fn default_prefix() -> String {
    "gdp/rib".into()
}

impl EtcdEntry {
    /// Checks the section. `rib` is whether this daemon is a RIB. Paths are relative to `folder`.
    pub fn check(mut self, rib: bool, folder: &Path) -> Result<EtcdConfig, String> {
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
        let access = self.access(&endpoints, folder)?;
        let prefix = self.prefix;
        let is_plain = prefix.chars().all(|c| c.is_ascii_graphic());
        if !is_plain || prefix.len() > MAX_PREFIX || prefix.split('/').any(str::is_empty) {
            return Err(format!(
                "etcd: the prefix {prefix:?} is not one to {MAX_PREFIX} visible characters, without a slash at its \
                 ends, such as gdp/rib"
            ));
        }
        Ok(EtcdConfig { endpoints, prefix, access })
    }

    fn access(&mut self, endpoints: &[Endpoint], folder: &Path) -> Result<Access, String> {
        let client = match (self.cert.take(), self.key.take()) {
            (Some(cert), Some(key)) => Some(ClientCertificate { cert: folder.join(cert), key: folder.join(key) }),
            (None, None) => None,
            (Some(_), None) => return Err("etcd: cert needs key, the file of its private key".into()),
            (None, Some(_)) => return Err("etcd: key needs cert, the file of its certificate".into()),
        };
        let login = match (self.user.take(), self.password_file.take()) {
            (Some(user), Some(_)) if user.is_empty() => return Err("etcd: user is empty".into()),
            (Some(user), Some(file)) => Some(Login { user, password_file: folder.join(file) }),
            (None, None) => None,
            (Some(_), None) => return Err("etcd: user needs password_file, a file with the password".into()),
            (None, Some(_)) => return Err("etcd: password_file needs user, whose password it has".into()),
        };
        if let Some(plain) = endpoints.iter().find(|endpoint| !endpoint.tls) {
            if endpoints.iter().any(|endpoint| endpoint.tls) {
                return Err(format!("etcd: {plain} is without TLS, and other endpoints are https"));
            }
            if self.ca.is_some() || client.is_some() {
                return Err(format!(
                    "etcd: ca, cert and key are of use with https endpoints only, and {plain} is none"
                ));
            }
            if login.is_some() {
                return Err(format!(
                    "etcd: the password of user would cross the network in clear to {plain}: use https"
                ));
            }
            return Ok(Access::default());
        }
        let ca = self.ca.take().ok_or("etcd: https endpoints need ca, the file of the CA that certifies them")?;
        Ok(Access { tls: Some(Tls { ca: folder.join(ca), client }), login })
    }
}
