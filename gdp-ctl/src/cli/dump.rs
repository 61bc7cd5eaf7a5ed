//! `gdp-ctl fib dump` and `rib dump`: all routes of the data plane, and all records of the RIB,
//! fetched page by page.

use clap::Subcommand;
use gdp_core::cert::CertError;
use gdp_core::name::NamePrefix;
use gdp_proto::control::Record;
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::Serialize;

use super::output::{short, table};
use super::topology::neighbours;
use crate::cli::context::Context;
use gdp_proto::admin::Request;
use gdp_proto::admin::tables::{FibReply, FibRoute, RibReply, RibSwitch};

#[derive(Debug, Subcommand)]
pub enum FibCommand {
    /// Print the routes. With XDP, the daemon reads them back from the kernel.
    Dump {
        /// Only names with this prefix.
        prefix: Option<NamePrefix>,
    },
}

#[derive(Debug, Subcommand)]
pub enum RibCommand {
    /// Print the switches, and the publishers, subscribers, servers and callers of names.
    Dump {
        /// Only names with this prefix.
        prefix: Option<NamePrefix>,
    },
}

/// Output of `gdp-ctl fib dump`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct FibOutput {
    routes: Vec<FibRoute>,
}

/// Output of `gdp-ctl rib dump`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct RibOutput {
    records: Vec<RecordOutput>,
    switches: Vec<RibSwitch>,
}

/// An entity's role for a name.
#[derive(Debug, Serialize, JsonSchema)]
pub struct RecordOutput {
    pub name: Name,
    /// `publisher`, `server`, `subscriber` or `caller`.
    pub role: String,
    pub entity: Name,
    pub switch: Name,
    /// Remaining lifetime in seconds.
    pub expires_in: u64,
}

impl RecordOutput {
    /// Converts a record without verifying it.
    pub fn new(record: &Record) -> Result<Self, CertError> {
        let (role, entity) = (record.role()?.to_string(), record.entity.name()?);
        Ok(Self { name: record.name, role, entity, switch: record.switch, expires_in: record.expires_in })
    }

    /// Returns its row in a table.
    pub fn row(&self) -> [String; 5] {
        let [name, entity, switch] = [self.name, self.entity, self.switch].map(|name| format!("{name:#}"));
        [name, self.role.clone(), entity, switch, format!("{} s", self.expires_in)]
    }
}

pub const RECORD_COLUMNS: [&str; 5] = ["name", "role", "entity", "switch", "expires in"];

pub fn fib(command: &FibCommand, context: &Context) -> anyhow::Result<()> {
    let FibCommand::Dump { prefix } = command;
    let (mut client, mut routes) = (context.client()?, Vec::<FibRoute>::new());
    let mut after = None;
    loop {
        let page: FibReply = client.ask(&Request::Fib { after })?;
        routes.extend(page.routes);
        let last = routes.last().map(|route| route.name);
        // A daemon that repeats a page must not make this loop endless.
        if !page.more || last == after {
            break;
        }
        after = last;
    }
    routes.retain(|route| matches(prefix.as_ref(), &route.name));
    let output = FibOutput { routes };
    context.output.print(&output, || {
        let row = |route: &FibRoute| {
            let name = format!("{:#}", route.name);
            let [toward, readers, writers] = [&route.toward, &route.readers, &route.writers].map(short);
            [name, route.egress_bits.clone(), toward, readers, writers]
        };
        let rows: Vec<_> = output.routes.iter().map(row).collect();
        table(["name", "egress bits", "toward", "local readers", "local writers"], &rows)
    })
}

pub fn rib(command: &RibCommand, context: &Context) -> anyhow::Result<()> {
    let RibCommand::Dump { prefix } = command;
    let (mut client, mut records) = (context.client()?, Vec::<Record>::new());
    let mut after = None;
    let switches = loop {
        let page: RibReply = client.ask(&Request::Rib { after })?;
        records.extend(page.records);
        let last = records.last().map(Record::key).transpose()?;
        if !page.more || last == after {
            break page.switches;
        }
        after = last;
    };
    let wanted = records.iter().filter(|record| matches(prefix.as_ref(), &record.name));
    let records = wanted.map(RecordOutput::new).collect::<Result<_, _>>()?;
    let output = RibOutput { records, switches };
    context.output.print(&output, || {
        let row = |switch: &RibSwitch| {
            let (name, attached) = (format!("{:#}", switch.switch), switch.attached.len().to_string());
            [name, switch.bit.to_string(), neighbours(&switch.neighbours), attached]
        };
        let switches: Vec<_> = output.switches.iter().map(row).collect();
        let records: Vec<_> = output.records.iter().map(RecordOutput::row).collect();
        let switches = table(["switch", "bit", "neighbours (cost)", "attached"], &switches);
        [switches, table(RECORD_COLUMNS, &records)].join(&String::new())
    })
}

fn matches(prefix: Option<&NamePrefix>, name: &Name) -> bool {
    prefix.is_none_or(|prefix| prefix.matches(name))
}
