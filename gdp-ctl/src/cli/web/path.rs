//! Who publishes and reads a name, and the path to it: what `gdp-ctl query` and `trace` print.

use std::collections::BTreeSet;

use gdp_core::name::NamePrefix;
use gdp_util::escape::Escaped;
use gdp_wire::Name;
use serde::Serialize;

use super::collect::Collector;
use super::snapshot::{Bounded, Labelled, Labels, text};
use crate::cli::query;
use crate::cli::trace::{self, TraceLines};

/// Most senders to whose switches the path is traced.
const MAX_SENDERS: usize = 2;

/// Most records of an answer.
const MAX_RECORDS: usize = 50;

#[derive(Debug, Serialize)]
pub struct PathAnswer {
    pub records: Bounded<RecordLine>,
    pub query_error: Option<String>,
    /// Lines as `gdp-ctl trace` prints them: to the name, or to the switches of its senders.
    pub trace: Vec<String>,
    /// The switches of each path, for the map.
    pub hops: Vec<Vec<String>>,
    pub trace_error: Option<String>,
}

/// A role of an entity for a name.
#[derive(Debug, Serialize)]
pub struct RecordLine {
    name: Labelled,
    role: String,
    entity: Labelled,
    switch: Labelled,
    /// Its certificates verify.
    verified: bool,
}

/// Asks the daemon. Blocks, for seconds where switches on the path are silent.
pub fn find(prefix: &NamePrefix, collector: &Collector) -> anyhow::Result<PathAnswer> {
    let labels = collector.labels();
    let queried = query::first_page(&mut collector.client()?, prefix);
    let senders = queried.iter().flatten().filter(|record| ["publisher", "server"].contains(&record.role.as_str()));
    let switches: BTreeSet<Name> = senders.map(|record| record.switch).take(MAX_SENDERS).collect();
    let (records, query_error) = match queried {
        Ok(records) => (Bounded::new(records.iter().map(|record| line(record, &labels)), MAX_RECORDS), None),
        Err(error) => (Bounded::default(), Some(text(&format!("{error:#}")))),
    };
    let (mut lines, mut hops, mut trace_error) = (Vec::new(), Vec::new(), None);
    let mut add = |traced: TraceLines| {
        lines.extend(traced.lines.iter().map(|line| Escaped(line).to_string()));
        let switches = |path: &Vec<Name>| path.iter().map(ToString::to_string).collect();
        hops.extend(traced.hops.iter().map(switches));
    };
    match trace::from_daemon(prefix, collector.client()?) {
        Ok(traced) => add(traced),
        Err(error) => {
            trace_error = Some(text(&format!("{error:#}")));
            // Only the switch of a sender has a route to the name.
            for switch in switches {
                if let Ok(traced) = trace::from_daemon(&switch.into(), collector.client()?) {
                    add(traced);
                }
            }
        }
    }
    Ok(PathAnswer { records, query_error, trace: lines, hops, trace_error })
}

fn line(record: &query::CheckedRecord, labels: &Labels) -> RecordLine {
    RecordLine {
        name: labels.of(record.name),
        role: record.role.clone(),
        entity: labels.of(record.entity),
        switch: labels.of(record.switch),
        verified: record.verified,
    }
}
