//! Who publishes and reads a name, and the path to it: what `gdp-ctl query` and `trace` print.

use gdp_core::name::NamePrefix;
use gdp_util::escape::Escaped;
use serde::Serialize;

use super::collect::Collector;
use super::snapshot::{Bounded, Labelled, Labels, text};
use crate::cli::{query, trace};

/// Most records of an answer.
const MAX_RECORDS: usize = 50;

#[derive(Debug, Serialize)]
pub struct PathAnswer {
    pub records: Bounded<RecordLine>,
    pub query_error: Option<String>,
    /// Lines as `gdp-ctl trace` prints them.
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
    let (records, query_error) = match queried {
        Ok(records) => (Bounded::new(records.iter().map(|record| line(record, &labels)), MAX_RECORDS), None),
        Err(error) => (Bounded::default(), Some(text(&format!("{error:#}")))),
    };
    let (mut lines, mut hops, mut trace_error) = (Vec::new(), Vec::new(), None);
    match trace::from_daemon(prefix, collector.client()?) {
        Ok(traced) => {
            lines = traced.lines.iter().map(|line| Escaped(line).to_string()).collect();
            let switches = |path: &Vec<gdp_wire::Name>| path.iter().map(ToString::to_string).collect();
            hops = traced.hops.iter().map(switches).collect();
        }
        Err(error) => trace_error = Some(text(&format!("{error:#}"))),
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
