//! `gdp-ctl trace`: shows every switch and domain on the data path to a name, with the time to
//! each.

use clap::Args;
use gdp_core::name::NamePrefix;
use gdp_proto::control::MAX_PATH;
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::Serialize;

use super::name_location::{Paths, millis, with_daemon_paths, with_paths};
use super::output::AlreadyPrinted;
use crate::cli::context::Context;
use crate::cli::node::NodeOptions;
use crate::client::Client;
use gdp_proto::admin::trace::{DomainHop, InsideHop, LocateReply, PathEnd, ProbeReply};
use gdp_proto::admin::words::Outcome;

/// Maximum number of probes for one hop.
const TRIES: usize = 3;

/// Number of consecutive hops without an answer after which the trace ends.
const SILENT: usize = 4;

/// Maximum number of paths, and of switches on each, in [`TraceLines`].
const MAX_SHOWN: usize = 4;
const SHOWN_HOPS: u8 = 16;

/// Show the switches on the path to a name, and the time to each.
///
/// Probes follow the path of the name's frames in the data plane from the daemon's switch. The
/// first goes one hop, the next two, and so on. The switch at the last hop answers through the
/// switches' daemons. Each time therefore includes the outward path in the data plane and the
/// return path between daemons. The daemon's switch must have a route to the name. It has
/// one if an entity that sends to the name is attached here, or if NAME is a switch.
///
/// Where the path leaves for another domain, the border switches on both sides measure the time
/// between them. The other domain reports how the path continues, in what time, and into which
/// domains. It reports its switches only with `trace: open` at its border. A domain answers for
/// names that it accepts from this one.
///
/// A machine without a daemon needs --switch, and a key and rights in its keyring. The first switch
/// is then the one to which the key attaches, and times include the link to it. A publisher traces
/// its topic, a reader the topic's publishers. The trace ends at the border of the domain.
#[derive(Debug, Args)]
pub struct Options {
    /// Name, first digits of a name, or name card.
    #[arg(value_name = "NAME|PREFIX|CARD")]
    what: String,
    /// Maximum number of switches of this domain to probe.
    #[arg(long, default_value_t = 64, value_name = "HOPS", value_parser = clap::value_parser!(u8).range(1..=64))]
    max_hops: u8,
    #[command(flatten)]
    node: NodeOptions,
}

/// Output of `gdp-ctl trace`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct TraceOutput {
    name: Name,
    /// One path to each egress switch of the name.
    paths: Vec<TracePath>,
}

/// The path to an egress switch, and its continuation in other domains.
#[derive(Debug, Serialize, JsonSchema)]
struct TracePath {
    egress: Name,
    /// Whether the path has answered completely.
    reached: bool,
    hops: Vec<TraceHop>,
    domains: Vec<DomainHop>,
}

/// A switch of this domain on the path.
#[derive(Debug, Serialize, JsonSchema)]
struct TraceHop {
    /// Number of switches from the first one, which is the daemon's or that of `--switch`.
    hop: u8,
    /// None without an answer.
    switch: Option<Name>,
    rtt_us: Option<u64>,
    /// None unless the switch is an egress switch of the name.
    end: Option<PathEnd>,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let trace = async |paths: &mut Paths<'_>| trace(options.max_hops, paths).await;
    for output in with_paths(&options.what, &options.node, context, trace)? {
        context.output.print(&output, || describe(&output))?;
        if !output.paths.iter().all(|path| path.reached) {
            let name = output.name;
            let reason = format!("the probes did not get to every switch where {name:#} is, or a domain does not tell");
            return Err(AlreadyPrinted(reason).into());
        }
    }
    Ok(())
}

/// A trace for a page that shows it.
pub struct TraceLines {
    pub lines: Vec<String>,
    /// The switches of each path.
    pub hops: Vec<Vec<Name>>,
}

/// Traces a name from the daemon's switch, to its first egress switches.
pub fn from_daemon(what: &NamePrefix, client: Client) -> anyhow::Result<TraceLines> {
    let of = async |paths: &mut Paths<'_>| {
        paths.locations.iter_mut().for_each(|location| location.egress.truncate(MAX_SHOWN));
        trace(SHOWN_HOPS, paths).await
    };
    let outputs = with_daemon_paths(what, client, of)?;
    let paths = outputs.iter().flat_map(|output| &output.paths);
    let hops = paths.map(|path| path.hops.iter().filter_map(|hop| hop.switch).collect()).collect();
    Ok(TraceLines { lines: outputs.iter().flat_map(describe).collect(), hops })
}

/// Traces the paths to each located name.
async fn trace(max_hops: u8, paths: &mut Paths<'_>) -> anyhow::Result<Vec<TraceOutput>> {
    let mut outputs = Vec::new();
    for location in paths.locations.clone() {
        let mut found = Vec::new();
        if location.egress.is_empty() {
            // The name is an endpoint with a link here, but nobody here may send to it.
            let (egress, hops) = (location.own, vec![own(&location, paths)]);
            found.push(TracePath { egress, reached: true, hops, domains: Vec::new() });
        }
        for egress in &location.egress {
            found.push(follow(&location, *egress, max_hops, paths).await?);
        }
        outputs.push(TraceOutput { name: location.name, paths: found });
    }
    Ok(outputs)
}

/// Traces the path to one egress switch.
async fn follow(
    location: &LocateReply,
    egress: Name,
    max_hops: u8,
    paths: &mut Paths<'_>,
) -> anyhow::Result<TracePath> {
    let mut hops = vec![own(location, paths)];
    let (mut reached, mut silent) = (egress == location.own, 0);
    for hop in 1..=max_hops {
        if reached || silent == SILENT {
            break;
        }
        let ProbeReply { switch, rtt_us, end } = ask(location, egress, hop, paths).await?;
        reached = end.is_some();
        silent = if switch.is_none() { silent + 1 } else { 0 };
        hops.push(TraceHop { hop, switch, rtt_us, end });
    }
    let domains = match hops.last().and_then(|last| last.end.as_ref()) {
        Some(end) => paths.beyond(location.name, egress, end)?,
        None => Vec::new(),
    };
    reached &= domains.iter().all(|domain| domain.inside.as_ref().is_some_and(|inside| inside.rtt_us.is_some()));
    Ok(TracePath { egress, reached, hops, domains })
}

async fn ask(location: &LocateReply, egress: Name, hops: u8, paths: &mut Paths<'_>) -> anyhow::Result<ProbeReply> {
    let mut answer = ProbeReply::default();
    for _ in 0..TRIES {
        answer = paths.probe(location, egress, hops).await?;
        if answer.switch.is_some() {
            break;
        }
    }
    Ok(answer)
}

/// Returns the first switch as the first hop of every path.
fn own(location: &LocateReply, paths: &Paths<'_>) -> TraceHop {
    let is_end = location.egress.is_empty() || location.egress.contains(&location.own);
    let rtt_us = Some(paths.first_us);
    TraceHop { hop: 0, switch: Some(location.own), rtt_us, end: is_end.then(|| location.end.clone()) }
}

fn describe(TraceOutput { name, paths }: &TraceOutput) -> Vec<String> {
    let mut lines = vec![format!("trace to {name}")];
    for path in paths {
        if paths.len() > 1 {
            lines.push(format!("toward switch {:#}", path.egress));
        }
        for TraceHop { hop, switch, rtt_us, end } in &path.hops {
            let time = if *hop == 0 && *rtt_us == Some(0) { "this switch".into() } else { time(*rtt_us, "no answer") };
            lines.push(format!("{hop:2}  {:11}  {time}{}", who(*switch), describe_end(end.as_ref())));
        }
        if path.hops.last().is_none_or(|last| last.end.is_none()) {
            lines.push("    nothing further on answers".into());
        }
        path.domains.iter().for_each(|domain| cross(domain, &mut lines));
    }
    lines
}

/// Describes a domain: its entry, and its inside.
fn cross(domain: &DomainHop, lines: &mut Vec<String>) {
    let indent = " ".repeat(4 * usize::from(domain.depth).min(MAX_PATH));
    let (name, entered) = (format!("{:#}", domain.domain), time(domain.rtt_us, "no answer to echoes"));
    lines.push(format!("{indent}domain {name}  by its switch {:#}  {entered}", domain.switch));
    let why_not = match domain.outcome {
        Outcome::Traced => None,
        Outcome::Refused => Some(format!("not traced: {}", domain.reason.as_deref().unwrap_or_default())),
        Outcome::Loop => Some("not traced: the name has crossed this domain before".into()),
        Outcome::TooFar => Some(format!("not traced: the name has crossed {MAX_PATH} domains already")),
        Outcome::Unanswered => Some("its border does not say what is behind it: no answer in time".into()),
    };
    lines.extend(why_not.map(|why_not| format!("{indent}  {why_not}")));
    let Some(inside) = &domain.inside else { return };
    let whole = time(inside.rtt_us, "no answer from all of it");
    let end = describe_end(Some(&PathEnd { links: inside.links, beyond: Vec::new() }));
    match &inside.hops {
        Some(hops) => {
            let line = |hop: &InsideHop| {
                format!("{indent}  {:2}  {:11}  {}", hop.hop, who(hop.switch), time(hop.rtt_us, "no answer"))
            };
            lines.extend(hops.iter().map(line));
            lines.push(format!("{indent}  inside of domain {name}  {whole}{end}"));
        }
        None => lines.push(format!("{indent}  … inside of domain {name} (masked)  {whole}{end}")),
    }
}

fn who(switch: Option<Name>) -> String {
    switch.map_or_else(|| "*".to_owned(), |switch| format!("{switch:#}"))
}

fn time(rtt_us: Option<u64>, none: &str) -> String {
    rtt_us.map_or_else(|| none.to_owned(), millis)
}

/// Describes the delivery at the last switch, or in a domain.
fn describe_end(end: Option<&PathEnd>) -> String {
    let Some(PathEnd { links, beyond }) = end else { return String::new() };
    let mut text = format!("  → {links} local {}", if *links == 1 { "link" } else { "links" });
    for beyond in beyond {
        text += &format!(", domain {:#} by its switch {:#}", beyond.domain, beyond.switch);
    }
    text
}

#[cfg(test)]
#[path = "../../tests/unit/cli/trace.rs"]
mod tests;
