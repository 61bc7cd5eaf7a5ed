//! Names as `trace` and `ping` take them, and what the daemon knows of where they are.

use std::path::Path;

use anyhow::Context as _;
use gdp_core::card::NameCard;
use gdp_core::name::NamePrefix;
use gdp_wire::Name;
use serde_json::Value;

use crate::client::Client;
use gdp_proto::admin::Request;

/// Where a name is, as the daemon's switch sees it.
pub struct NameLocation {
    pub name: Name,
    /// The daemon's switch.
    pub own: Name,
    /// It has a link with that switch.
    pub is_near: bool,
    /// The egress switches of the name.
    pub egress: Vec<Name>,
    /// What that switch itself delivers the name to.
    pub end: Value,
}

/// A card file, a whole name, or the first digits of one name that the daemon's switch knows.
pub fn find(what: &str, client: &mut Client) -> anyhow::Result<NameLocation> {
    let path = Path::new(what);
    let prefix: NamePrefix = if path.is_file() {
        NameCard::load(path)?.name().into()
    } else {
        what.parse().with_context(|| format!("{what} is neither a file nor the beginning of a name"))?
    };
    let reply = client.ask_value(&Request::Locate { what: prefix })?;
    let name = |value: &Value| value.as_str().unwrap_or_default().parse::<Name>();
    let egress = reply["egress"].as_array().into_iter().flatten().map(name).collect::<Result<_, _>>();
    Ok(NameLocation {
        name: name(&reply["name"])?,
        own: name(&reply["own"])?,
        is_near: reply["near"].as_bool().unwrap_or_default(),
        egress: egress.context("the daemon gave an answer that this program does not understand")?,
        end: reply["end"].clone(),
    })
}

/// A time in microseconds, as milliseconds.
pub fn millis(micros: u64) -> String {
    format!("{}.{:03} ms", micros / 1000, micros % 1000)
}
