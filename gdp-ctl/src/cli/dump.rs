//! `gdp-ctl fib dump` and `rib dump`: all that the data plane forwards by, all that the RIB knows.
//! Fetched page by page.

use clap::Subcommand;
use gdp_core::name::NamePrefix;
use gdp_proto::control::Record;
use serde_json::{Value, json};

use super::output::{short, table};
use crate::cli::context::Context;
use crate::client::{Client, ClientError};
use gdp_proto::admin::Request;

#[derive(Debug, Subcommand)]
pub enum FibCommand {
    /// Print the routes, read back from the kernel where XDP runs.
    Dump {
        /// Only names that begin so.
        prefix: Option<NamePrefix>,
    },
}

#[derive(Debug, Subcommand)]
pub enum RibCommand {
    /// Print switches, and who writes, reads, serves and calls.
    Dump {
        /// Only names that begin so.
        prefix: Option<NamePrefix>,
    },
}

pub fn fib(command: &FibCommand, context: &Context) -> anyhow::Result<()> {
    let FibCommand::Dump { prefix } = command;
    let name = |route: &Value| route["name"].as_str().and_then(|name| name.parse().ok());
    let (mut routes, _) = all(&mut context.client()?, "routes", name, |after| Request::Fib { after })?;
    keep(&mut routes, prefix.as_ref());
    context.output.print(json!({"routes": routes}), || {
        let rows: Vec<_> = routes
            .iter()
            .map(|route| {
                let toward: Vec<_> = route["toward"].as_array().into_iter().flatten().map(short).collect();
                let bits = route["egress_bits"].as_str().unwrap_or_default().to_owned();
                let writers: Vec<_> = route["writers"].as_array().into_iter().flatten().map(short).collect();
                let readers: Vec<_> = route["readers"].as_array().into_iter().flatten().map(short).collect();
                [short(&route["name"]), bits, toward.join(" "), readers.join(" "), writers.join(" ")]
            })
            .collect();
        table(["name", "egress bits", "toward", "local readers", "local writers"], &rows)
    })
}

pub fn rib(command: &RibCommand, context: &Context) -> anyhow::Result<()> {
    let RibCommand::Dump { prefix } = command;
    let place = |record: &Value| serde_json::from_value::<Record>(record.clone()).ok()?.place().ok();
    let (mut records, last) = all(&mut context.client()?, "records", place, |after| Request::Rib { after })?;
    keep(&mut records, prefix.as_ref());
    let records: Vec<Value> = records.into_iter().map(describe).collect::<Result<_, ClientError>>()?;
    let switches = last["switches"].clone();
    context.output.print(json!({"records": records, "switches": switches}), || {
        let switches: Vec<_> = switches
            .as_array()
            .into_iter()
            .flatten()
            .map(|switch| {
                let near = switch["neighbours"].as_array().into_iter().flatten();
                let near: Vec<_> = near.map(|n| format!("{} ({})", short(&n["switch"]), n["cost"])).collect();
                let attached = switch["attached"].as_array().map_or(0, Vec::len);
                [short(&switch["switch"]), switch["bit"].to_string(), near.join(" "), attached.to_string()]
            })
            .collect();
        let rows: Vec<_> = records
            .iter()
            .map(|r| {
                let role = r["role"].as_str().unwrap_or_default().to_owned();
                [short(&r["name"]), role, short(&r["entity"]), short(&r["switch"]), format!("{} s", r["expires_in"])]
            })
            .collect();
        let mut lines = table(["switch", "bit", "neighbours (cost)", "attached"], &switches);
        lines.push(String::new());
        lines.extend(table(["name", "role", "entity", "switch", "expires in"], &rows));
        lines
    })
}

/// All entries of a dump, and its last page.
fn all<NameLocation: Copy + PartialEq>(
    client: &mut Client,
    key: &str,
    place: impl Fn(&Value) -> Option<NameLocation>,
    request: impl Fn(Option<NameLocation>) -> Request,
) -> Result<(Vec<Value>, Value), ClientError> {
    let (mut entries, mut after) = (Vec::new(), None);
    loop {
        let mut page = client.ask_value(&request(after))?;
        let Value::Array(new) = page[key].take() else {
            return Err(ClientError::Malformed(format!("no {key} in a page")));
        };
        entries.extend(new);
        let last = entries.last().and_then(&place);
        // A daemon that repeats itself must not keep this program for ever.
        if page["more"] != true || last == after {
            return Ok((entries, page));
        }
        after = last;
    }
}

fn keep(entries: &mut Vec<Value>, prefix: Option<&NamePrefix>) {
    if let Some(prefix) = prefix {
        entries.retain(|e| e["name"].as_str().is_some_and(|name| name.starts_with(prefix.as_str())));
    }
}

fn describe(record: Value) -> Result<Value, ClientError> {
    let record: Record = serde_json::from_value(record).map_err(|e| ClientError::Malformed(e.to_string()))?;
    let role = record.role().map_err(|e| ClientError::Malformed(e.to_string()))?.to_string();
    let entity = record.entity.name().map_err(|e| ClientError::Malformed(e.to_string()))?;
    Ok(json!({
        "name": record.name, "role": role, "entity": entity, "switch": record.switch, "expires_in": record.expires_in,
    }))
}
