//! Name arguments of `trace` and `ping`, and their location in the daemon's view.

use std::path::Path;

use anyhow::Context as _;
use gdp_core::card::NameCard;
use gdp_core::name::NamePrefix;

use crate::client::Client;
use gdp_proto::admin::Request;
use gdp_proto::admin::trace::LocateReply;

/// Finds a name by card file, whole name, or a unique prefix among the names that the daemon's
/// switch knows.
pub fn find(what: &str, client: &mut Client) -> anyhow::Result<LocateReply> {
    let path = Path::new(what);
    let prefix: NamePrefix = if path.is_file() {
        NameCard::load(path)?.name().into()
    } else {
        what.parse().with_context(|| format!("{what} is neither a file nor the beginning of a name"))?
    };
    Ok(client.ask(&Request::Locate { what: prefix })?)
}

/// Formats a time in microseconds as milliseconds.
pub fn millis(micros: u64) -> String {
    format!("{}.{:03} ms", micros / 1000, micros % 1000)
}
