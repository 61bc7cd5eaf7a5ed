//! The link of a member to its domain, as `gdp-proxy join` wrote it.

use std::fs::File;
use std::io::Read as _;
use std::path::Path;

use gdp_core::link_target::LinkTarget;
use serde::Deserialize;

use super::error::KeyringError;
use crate::node::LinkConfig;

/// Maximum size of the configuration file, in bytes.
const MAX_FILE: u64 = 1 << 20;

/// The part of a proxy's configuration that is read. The proxy checks the others.
#[derive(Deserialize)]
struct ProxyFile {
    links: Vec<LinkEntry>,
}

#[derive(Deserialize)]
struct LinkEntry {
    to: String,
    switch: Option<String>,
}

/// Returns the links of the proxy's configuration in this folder, in order of preference.
pub fn links(folder: &Path) -> Result<Vec<LinkConfig>, KeyringError> {
    let path = folder.join("proxy.yaml");
    let read = || {
        let mut text = String::new();
        let file = File::open(&path).map_err(|error| error.to_string())?;
        file.take(MAX_FILE).read_to_string(&mut text).map_err(|error| error.to_string())?;
        let ProxyFile { links } = gdp_util::yaml::parse(&text)?;
        let links = links.into_iter().map(link).collect::<Result<Vec<_>, String>>()?;
        if links.is_empty() { Err("it has no link".to_owned()) } else { Ok(links) }
    };
    read().map_err(|reason| KeyringError::Links { path: path.clone(), reason })
}

fn link(LinkEntry { to, switch }: LinkEntry) -> Result<LinkConfig, String> {
    let target: LinkTarget = to.parse().map_err(|error| format!("{to}: {error}"))?;
    let switch = switch.map(|name| name.parse().map_err(|error| format!("{name}: {error}"))).transpose()?;
    Ok(LinkConfig { switch, ..target.into() })
}
