//! What the screen shows: the rows of each table, from two samples. Pure, so that tests need no
//! program that runs.

use std::cmp::{Ordering, Reverse};
use std::collections::HashMap;

use gdp_proto::admin::links::{Counts, LinkStatus};
use gdp_proto::admin::proxy::{ProxyReply, ProxyTopic};
use gdp_proto::admin::status::{StatusReply, Warning};
use gdp_util::escape::Escaped;

use super::sample::TopSample;
use super::sort_key::SortKey;
use crate::cli::proxy_status::{millis, state};

/// How a row or line looks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Tone {
    #[default]
    Plain,
    /// It is quiet or waits.
    Dim,
    /// It needs attention.
    Alert,
}

/// A table with a title, which is its first column's heading.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Grid {
    pub heading: Vec<&'static str>,
    pub rows: Vec<(Tone, Vec<String>)>,
}

/// The whole screen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Model {
    pub title: String,
    pub notes: Vec<(Tone, String)>,
    /// Topics, names, links, drops and robots, as far as there are any.
    pub grids: Vec<Grid>,
    pub sort: SortKey,
}

impl Model {
    /// `before` is the sample of which rates are the difference.
    pub fn new(before: Option<&TopSample>, now: &TopSample, sort: SortKey) -> Self {
        let seconds = before.map(|before| now.at.saturating_duration_since(before.at).as_secs_f64());
        let mut model = Self { title: title(now), notes: Vec::new(), grids: Vec::new(), sort };
        model.notes.extend(now.problem.iter().map(|problem| (Tone::Alert, clean(problem))));
        if let Some(proxy) = &now.proxy {
            let before = before.and_then(|before| before.proxy.as_deref());
            model.notes.extend(proxy_notes(proxy));
            model.grids.push(topics(before, proxy, now, seconds, sort));
        }
        if let Some(switch) = &now.switch {
            let before = before.and_then(|before| before.switch.as_deref());
            model.notes.extend(switch_notes(switch));
            model.grids.push(links(before, switch, seconds));
            model.grids.push(names(before, switch, now.proxy.as_deref(), seconds));
            model.grids.push(drops(before, switch, seconds));
        }
        model.grids.push(robots(now));
        model.grids.retain(|grid| !grid.rows.is_empty());
        model
    }
}

fn title(now: &TopSample) -> String {
    let mut parts = vec!["gdp-ctl top".to_owned()];
    if let Some(switch) = &now.switch {
        parts.push(format!("switch {:#} ({})", switch.name, switch.data_plane));
        parts.push(format!("{} of {} switches reached", switch.topology.reached, switch.topology.switches));
    }
    if !now.robots.is_empty() {
        let online = now.robots.iter().filter(|robot| robot.state == "online").count();
        parts.push(format!("{online} of {} robots online", now.robots.len()));
    }
    // A narrow screen cuts what comes last.
    if let Some(proxy) = &now.proxy {
        parts.push(format!("proxy {:#}", proxy.entity));
    }
    if let Some(switch) = &now.switch {
        parts.push(format!("names {}", switch.fib.names));
    }
    clean(&parts.join(" · "))
}

fn proxy_notes(proxy: &ProxyReply) -> Vec<(Tone, String)> {
    let mut notes = Vec::new();
    if proxy.switch.is_none() {
        let reason = proxy.links.iter().find_map(|link| link.reason.clone()).unwrap_or_default();
        notes.push((Tone::Alert, clean(&format!("the proxy has no switch: {reason}"))));
    }
    notes.extend(proxy.clocks.iter().map(|clock| (Tone::Alert, clean(&clock.to_string()))));
    notes.extend(proxy.member_error.iter().map(|error| (Tone::Alert, clean(&format!("membership: {error}")))));
    notes
}

fn switch_notes(switch: &StatusReply) -> Vec<(Tone, String)> {
    let control = switch.control.reason.as_ref().filter(|_| !switch.control.ready);
    let control = control.map(|reason| format!("RIB not reached: {reason}"));
    let domain = switch.domain.iter().filter_map(|domain| domain.error.as_ref());
    let domain = domain.map(|error| format!("membership: {error}"));
    let errors = switch.errors.iter().map(|error| format!("error: {error}"));
    let alerts = control.into_iter().chain(domain).chain(errors).map(|text| (Tone::Alert, clean(&text)));
    let warnings = switch.warnings.iter().map(|warning| match warning {
        Warning::Silent { entity, for_s, .. } => format!("{entity:#} has sent nothing for {for_s} s"),
        Warning::NotServed { count, .. } => format!("{count} names are read or called, and nobody publishes them"),
        Warning::Open => "of no domain: every endpoint that reaches this switch gets a link".to_owned(),
        Warning::SmallMtu { interface, mtu, needed } => format!("{interface}: MTU {mtu}, and links need {needed}"),
    });
    let refused = switch.refused.iter().take(3);
    let refused = refused.map(|of| format!("refused a {} of {:#}, × {}: {}", of.what, of.peer, of.count, of.reason));
    alerts.chain(warnings.chain(refused).map(|text| (Tone::Dim, clean(&text)))).collect()
}

struct TopicRow<'a> {
    topic: &'a ProxyTopic,
    messages: Option<f64>,
    bytes: Option<f64>,
    is_losing: bool,
}

fn topics(
    before: Option<&ProxyReply>,
    proxy: &ProxyReply,
    now: &TopSample,
    seconds: Option<f64>,
    sort: SortKey,
) -> Grid {
    let key = |topic: &ProxyTopic| (topic.graph.clone(), topic.topic.clone(), topic.direction.as_str(), topic.name);
    let earlier: HashMap<_, _> =
        before.into_iter().flat_map(|it| &it.topics).map(|topic| (key(topic), topic)).collect();
    let row = |topic| {
        let before = earlier.get(&key(topic)).copied();
        let of = |count: fn(&ProxyTopic) -> u64| rate(before.map(count), count(topic), seconds);
        TopicRow {
            topic,
            messages: of(|topic| topic.messages),
            bytes: of(|topic| topic.bytes),
            is_losing: before.is_some_and(|before| topic.lost() > before.lost()),
        }
    };
    let mut rows: Vec<TopicRow> = proxy.topics.iter().map(row).collect();
    rows.sort_by(|one, other| by(sort, one, other).then_with(|| one.topic.topic.cmp(&other.topic.topic)));
    let cells = |row: &TopicRow| {
        let topic = row.topic;
        let is_up = topic.status == "up" && topic.waiting_for.is_none();
        let tone = match (row.is_losing, is_up) {
            (true, _) => Tone::Alert,
            (false, true) => Tone::Plain,
            (false, false) => Tone::Dim,
        };
        let lost = format!("{}{}", topic.lost(), if row.is_losing { "!" } else { "" });
        let cells = [
            topic.topic.clone(),
            topic.direction.to_string(),
            real(row.messages, 1.0),
            megabytes(row.bytes),
            lost,
            topic.latency_us.arrival.map_or_else(|| "–".into(), |times| millis(times.p99)),
            topic.readers().map_or_else(|| "–".into(), |readers| readers.to_string()),
            now.paths.get(&topic.name).cloned().unwrap_or_else(|| "–".into()),
            state(&topic.status, topic.waiting_for.as_deref()),
        ];
        (tone, cells.iter().map(|cell| clean(cell)).collect())
    };
    Grid {
        heading: vec!["TOPIC", "", "MSG/S", "MB/S", "LOST", "AGE P99", "READERS", "PATH", "STATE"],
        rows: rows.iter().map(cells).collect(),
    }
}

fn by(sort: SortKey, one: &TopicRow, other: &TopicRow) -> Ordering {
    let descending = |value: fn(&TopicRow) -> f64| value(other).total_cmp(&value(one));
    match sort {
        SortKey::Messages => descending(|row| row.messages.unwrap_or(row.topic.messages as f64)),
        SortKey::Bytes => descending(|row| row.bytes.unwrap_or(row.topic.bytes as f64)),
        SortKey::Lost => descending(|row| row.topic.lost() as f64),
        SortKey::Age => descending(|row| row.topic.latency_us.arrival.map_or(-1.0, |times| f64::from(times.p99))),
        SortKey::Name => Ordering::Equal,
    }
}

fn links(before: Option<&StatusReply>, switch: &StatusReply, seconds: Option<f64>) -> Grid {
    let earlier: HashMap<u32, &LinkStatus> =
        before.into_iter().flat_map(|status| &status.links).map(|link| (link.id, link)).collect();
    let mut links: Vec<_> = switch.links.iter().collect();
    links.sort_by_key(|link| Reverse(link.sent + sum(&link.arrivals, |_| true)));
    let row = |link: &LinkStatus| {
        let before = earlier.get(&link.id).copied();
        let of = |count: fn(&LinkStatus) -> u64| rate(before.map(count), count(link), seconds);
        let dropped = of(|link| sum(&link.arrivals, is_drop));
        let cells = [
            format!("{:#}", link.peer),
            link.role.to_string(),
            link.via.clone(),
            format!("{:.1} ms", link.rtt_us as f64 / 1e3),
            real(of(|link| link.sent), 1.0),
            real(of(|link| sum(&link.arrivals, |_| true)), 1.0),
            real(dropped, 1.0),
        ];
        let is_lossy = dropped.is_some_and(|rate| rate > 0.0);
        let tone = if is_lossy || !link.carrier || !link.answers { Tone::Alert } else { Tone::Plain };
        (tone, cells.iter().map(|cell| clean(cell)).collect())
    };
    Grid {
        heading: vec!["LINK TO", "ROLE", "VIA", "RTT", "SENT/S", "RECEIVED/S", "DROPPED/S"],
        rows: links.into_iter().map(row).collect(),
    }
}

fn names(before: Option<&StatusReply>, switch: &StatusReply, proxy: Option<&ProxyReply>, seconds: Option<f64>) -> Grid {
    // The switch does not know ROS names.
    let topics: HashMap<_, &str> =
        proxy.into_iter().flat_map(|proxy| &proxy.topics).map(|topic| (topic.name, topic.topic.as_str())).collect();
    let earlier: HashMap<_, u64> =
        before.into_iter().flat_map(|status| &status.busiest).map(|busy| (busy.name, busy.frames)).collect();
    let row = |busy: &gdp_proto::admin::status::BusyName| {
        let rate = rate(earlier.get(&busy.name).copied(), busy.frames, seconds);
        let topic = clean(topics.get(&busy.name).copied().unwrap_or("–"));
        (Tone::Plain, vec![format!("{:#}", busy.name), real(rate, 1.0), busy.frames.to_string(), topic])
    };
    Grid {
        heading: vec!["BUSIEST NAME", "FRAMES/S", "FRAMES, ABOUT", "TOPIC"],
        rows: switch.busiest.iter().map(row).collect(),
    }
}

fn drops(before: Option<&StatusReply>, switch: &StatusReply, seconds: Option<f64>) -> Grid {
    let reasons = switch.counters.iter().filter(|(counter, frames)| is_drop(counter) && **frames > 0);
    let row = |(counter, frames): (&String, &u64)| {
        let earlier = before.map(|status| status.counters.get(counter).copied().unwrap_or(0));
        let rate = rate(earlier, *frames, seconds);
        let tone = if rate.is_some_and(|rate| rate > 0.0) { Tone::Alert } else { Tone::Plain };
        (tone, vec![counter.clone(), real(rate, 1.0), frames.to_string()])
    };
    Grid { heading: vec!["DROP", "FRAMES/S", "FRAMES"], rows: reasons.map(row).collect() }
}

fn robots(now: &TopSample) -> Grid {
    let row = |robot: &super::sample::RobotState| {
        let tone = match robot.state.as_str() {
            "online" | "joined" => Tone::Plain,
            "pending" => Tone::Alert,
            _ => Tone::Dim,
        };
        (tone, [&robot.label, &robot.state, &robot.expose].map(|cell| clean(cell)).into())
    };
    Grid { heading: vec!["ROBOT", "STATE", "EXPOSES"], rows: now.robots.iter().map(row).collect() }
}

/// Returns the difference in a second. `None` without an earlier value, or after a restart.
fn rate(before: Option<u64>, now: u64, seconds: Option<f64>) -> Option<f64> {
    let (before, seconds) = (before?, seconds.filter(|seconds| *seconds > 0.0)?);
    Some(now.checked_sub(before)? as f64 / seconds)
}

fn real(value: Option<f64>, unit: f64) -> String {
    value.map_or_else(|| "–".into(), |value| format!("{:.1}", value / unit))
}

/// As [`real`], and a few kilobytes are not zero.
fn megabytes(bytes: Option<f64>) -> String {
    match bytes {
        Some(bytes) if bytes < 1e6 => format!("{:.3}", bytes / 1e6),
        bytes => real(bytes, 1e6),
    }
}

fn is_drop(counter: &str) -> bool {
    counter.starts_with("drop_")
}

fn sum(counts: &Option<Counts>, which: fn(&str) -> bool) -> u64 {
    counts.iter().flatten().filter(|(counter, _)| which(counter)).map(|(_, frames)| frames).sum()
}

/// Escapes control characters of foreign text.
fn clean(text: &str) -> String {
    Escaped(text).to_string()
}

#[cfg(test)]
#[path = "../../../tests/unit/cli/top.rs"]
mod tests;
