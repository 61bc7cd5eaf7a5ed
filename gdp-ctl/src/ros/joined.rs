//! The link of a member to its domain, as `gdp-proxy join` wrote it.

use std::fs::File;
use std::io::Read as _;
use std::path::Path;

use anyhow::{Context as _, anyhow};
use gdp::LinkConfig;
use serde::Deserialize;

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
pub fn links(folder: &Path) -> anyhow::Result<Vec<LinkConfig>> {
    let path = folder.join("proxy.yaml");
    let read = || {
        let mut text = String::new();
        File::open(&path)?.take(MAX_FILE).read_to_string(&mut text)?;
        let ProxyFile { links } = gdp_util::yaml::parse(&text).map_err(|error| anyhow!(error))?;
        let link = |LinkEntry { to, switch }: LinkEntry| {
            let switch = switch.map(|name| name.parse()).transpose()?;
            anyhow::Ok(LinkConfig { switch, ..LinkConfig::from(to.parse::<gdp::LinkTarget>()?) })
        };
        let links = links.into_iter().map(link).collect::<anyhow::Result<Vec<_>>>()?;
        if links.is_empty() { Err(anyhow!("it has no link")) } else { Ok(links) }
    };
    read().with_context(|| format!("{}: no link to the switch; give one with --switch", path.display()))
}
