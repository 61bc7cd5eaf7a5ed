//! `gdp-ctl status` of a proxy, as lines.

use gdp_proto::admin::proxy::{ProxyCall, ProxyReply, ProxyTopic};
use gdp_util::date::relative;
use gdp_util::unix_time::unix_seconds;

use super::output::{or_dash, table};

pub fn describe(status: &ProxyReply) -> Vec<String> {
    let mut lines = vec![format!("proxy       {}", status.entity)];
    lines.push(match status.switch {
        Some(switch) => format!("switch      {switch}"),
        None => "switch      none answers".into(),
    });
    lines.extend(status.member_until.map(|until| format!("member      until {}", relative(until, unix_seconds()))));
    lines.extend(status.member_error.as_ref().map(|error| format!("member      no longer: {error}")));
    lines.extend(status.directory.as_ref().map(|directory| format!("directory   {}", directory.status)));
    lines.extend(status.clocks.iter().map(|clock| format!("warning: {clock}")));
    let links = status.links.iter().map(|link| {
        let why = link.reason.clone().unwrap_or_default();
        [link.target.clone(), link.state.to_string(), link.frames_sent.to_string(), why]
    });
    lines.push(String::new());
    lines.extend(table(["link to", "state", "sent", "reason"], &links.collect::<Vec<_>>()));
    let topics: Vec<_> = status.topics.iter().map(topic).collect();
    if !topics.is_empty() {
        lines.push(String::new());
        lines.extend(table(["topic", "", "messages", "bytes", "lost", "age p99", "readers", "status"], &topics));
    }
    let calls: Vec<_> = status.calls.iter().map(call).collect();
    if !calls.is_empty() {
        lines.push(String::new());
        lines.extend(table(["service", "", "calls", "answers", "servers", "status"], &calls));
    }
    lines
}

fn topic(topic: &ProxyTopic) -> [String; 8] {
    let age = topic.latency_us.arrival.map(|times| millis(times.p99));
    [
        topic.topic.clone(),
        topic.direction.to_string(),
        topic.messages.to_string(),
        topic.bytes.to_string(),
        topic.lost().to_string(),
        or_dash(age),
        or_dash(topic.readers()),
        state(&topic.status, topic.waiting_for.as_deref()),
    ]
}

fn call(call: &ProxyCall) -> [String; 6] {
    [
        call.service.clone(),
        call.direction.to_string(),
        call.calls.to_string(),
        call.answers.to_string(),
        call.servers.to_string(),
        state(&call.status, call.waiting_for.as_deref()),
    ]
}

/// Returns what a route waits for, or else its status.
pub fn state(status: &str, waiting_for: Option<&str>) -> String {
    match waiting_for {
        Some(waiting) if status == "up" => format!("waits for: {}", waiting.replace('_', " ")),
        _ => status.to_owned(),
    }
}

/// Returns microseconds in milliseconds.
pub fn millis(micros: u32) -> String {
    match micros {
        ..10_000 => format!("{:.1} ms", f64::from(micros) / 1e3),
        _ => format!("{} ms", micros / 1000),
    }
}
