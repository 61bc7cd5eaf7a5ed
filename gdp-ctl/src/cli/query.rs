//! `gdp-ctl query`: the publishers, readers, servers and callers of a name. The command trusts
//! neither the daemon nor the RIB: it verifies every record itself.

use std::path::Path;

use anyhow::{Context as _, bail};
use clap::Args;
use gdp_core::card::NameCard;
use gdp_core::cert::CertError;
use gdp_core::name::NamePrefix;
use gdp_proto::control::{EntityRequest, Record, Response};
use gdp_util::terminal::note;
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::Serialize;

use super::dump::{RECORD_COLUMNS, RecordOutput};
use super::output::table;
use crate::cli::context::Context;
use crate::cli::node::NodeOptions;
use crate::client::Client;
use crate::ros::fabric::Fabric;
use gdp_proto::admin::Request;
use gdp_util::unix_time::unix_seconds;

/// Maximum number of records shown.
const MOST: usize = 100_000;

#[derive(Debug, Args)]
pub struct Options {
    /// Name, first digits of several names, or name card.
    #[arg(value_name = "NAME|PREFIX|CARD")]
    what: String,
    #[command(flatten)]
    node: NodeOptions,
}

/// Output of `gdp-ctl query`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct QueryOutput {
    records: Vec<VerifiedRecord>,
    /// Whether there are more records.
    truncated: bool,
}

/// An entity's role for a name; this command has verified its certificates.
#[derive(Debug, Serialize, JsonSchema)]
struct VerifiedRecord {
    #[serde(flatten)]
    record: RecordOutput,
    /// Always true.
    verified: bool,
}

impl VerifiedRecord {
    fn new(record: &Record, now: u64) -> Result<Self, CertError> {
        record.verify(None, now)?;
        Ok(Self { record: RecordOutput::new(record)?, verified: true })
    }
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let prefix = prefix(&options.what)?;
    let (records, truncated) = match options.node.asks_elsewhere(context) {
        true => {
            let by_node = async |fabric: &Fabric| fabric.records(&prefix).await;
            options.node.with_fabric(options.node.keyring()?, context, by_node)?
        }
        false => ask(&mut context.client()?, &prefix)?,
    };
    if records.is_empty() {
        bail!("nobody publishes, reads, serves or calls {prefix}");
    }
    let now = unix_seconds();
    let mut verified = Vec::new();
    for record in &records {
        if !prefix.matches(&record.name) {
            bail!("the answer contains {}, which was not asked for: the RIB is faulty or lies", record.name);
        }
        let record = VerifiedRecord::new(record, now)
            .with_context(|| format!("the RIB's record of {} does not verify: it is faulty or lies", record.name))?;
        verified.push(record);
    }
    if truncated {
        note("gdp-ctl: there are more; ask with more digits of the name");
    }
    let output = QueryOutput { records: verified, truncated };
    context.output.print(&output, || {
        table(RECORD_COLUMNS, &output.records.iter().map(|verified| verified.record.row()).collect::<Vec<_>>())
    })
}

/// A record, and whether its certificates verify.
pub struct CheckedRecord {
    pub name: Name,
    pub role: String,
    pub entity: Name,
    pub switch: Name,
    pub verified: bool,
}

/// Returns the first records of the names with this prefix.
pub fn first_page(client: &mut Client, prefix: &NamePrefix) -> anyhow::Result<Vec<CheckedRecord>> {
    let request = EntityRequest::Query { prefix: prefix.clone(), after: None };
    let Response::Records { records, .. } = client.ask(&Request::Entity { entity: None, request: request.into() })?
    else {
        bail!("the RIB answered another question");
    };
    let now = unix_seconds();
    let check = |record: &Record| -> anyhow::Result<CheckedRecord> {
        let verified = prefix.matches(&record.name) && record.verify(None, now).is_ok();
        let RecordOutput { name, role, entity, switch, .. } = RecordOutput::new(record)?;
        Ok(CheckedRecord { name, role, entity, switch, verified })
    };
    records.iter().map(check).collect()
}

/// Returns the records of the names with this prefix, and whether there are more than the maximum.
pub fn ask(client: &mut Client, prefix: &NamePrefix) -> anyhow::Result<(Vec<Record>, bool)> {
    let mut records: Vec<Record> = Vec::new();
    loop {
        let after = records.last().map(Record::key).transpose()?;
        let request = EntityRequest::Query { prefix: prefix.clone(), after };
        let Response::Records { records: page, truncated } =
            client.ask(&Request::Entity { entity: None, request: request.into() })?
        else {
            bail!("the RIB answered another question");
        };
        for record in page {
            if records.last().map(Record::key).transpose()? >= Some(record.key()?) {
                bail!("the answer is out of order at {}: the RIB is faulty or lies", record.name);
            }
            records.push(record);
        }
        if !truncated || records.len() >= MOST || records.last().map(Record::key).transpose()? == after {
            return Ok((records, truncated));
        }
    }
}

/// Returns the name of a card file, or a prefix from digits.
fn prefix(what: &str) -> anyhow::Result<NamePrefix> {
    let path = Path::new(what);
    if path.is_file() {
        return Ok(NameCard::load(path)?.name().into());
    }
    what.parse().with_context(|| format!("{what} is neither a file nor the beginning of a name"))
}
