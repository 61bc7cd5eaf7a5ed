//! The metrics of a proxy: the figures of its status, for Prometheus. The label values are of
//! closed sets, or of at most [`MAX_SERIES`] topics or services.

use std::collections::BTreeMap;

use gdp_http::metrics::{Exposition, MAX_SERIES, OTHER};
use gdp_proto::admin::proxy::{ProxyCall, ProxyReply, ProxyTopic, StagePercentiles};
use gdp_proto::admin::words::FabricLinkState;

gdp_http::metrics! {
    BUILD: gauge "gdp_proxy_build_info" ["version"] "Always 1; the label has the release";
    ATTACHED: gauge "gdp_proxy_attached" [] "Whether a switch is at the other end of the main link";
    MEMBERSHIP_VALID: gauge "gdp_proxy_membership_valid" [] "Whether the membership of the proxy in its domain is valid";
    MEMBERSHIP_EXPIRY: gauge "gdp_proxy_membership_expiry_timestamp_seconds" [] "When the membership of the proxy ends";
    DIRECTORY_UP: gauge "gdp_proxy_directory_up" [] "Whether the proxy has the directory of its domain";
    ROUTES: gauge "gdp_proxy_routes" ["kind", "state"] "Topics and calls by state: up, what they wait for, or other";
    DROPS: counter "gdp_proxy_dropped_messages" ["reason"] "Messages of all topics that the proxy dropped, by reason";
    FAILURES: counter "gdp_proxy_failed_calls" ["reason"] "Calls of all services and actions without an answer, by reason";
    TOPIC_MESSAGES: counter "gdp_topic_messages" ["graph", "topic", "direction"] "Messages carried";
    TOPIC_BYTES: counter "gdp_topic_bytes" ["graph", "topic", "direction"] "Bytes of the carried messages";
    TOPIC_CARRIED: counter "gdp_topic_carried_bytes" ["graph", "topic", "direction"] "Bytes of the carried messages as they travel: fewer if compressed";
    TOPIC_LOST: counter "gdp_topic_lost_messages" ["graph", "topic", "direction"] "Messages that were lost or dropped, at this proxy or before it";
    TOPIC_UP: gauge "gdp_topic_up" ["graph", "topic", "direction"] "Whether the topic is carried and waits for nothing";
    TOPIC_READERS: gauge "gdp_topic_readers" ["graph", "topic", "direction"] "Attached readers of a topic that this side publishes";
    TOPIC_AGE: gauge "gdp_topic_age_seconds" ["graph", "topic", "direction", "percentile"] "Age of the latest 1024 messages when the proxy has them; in: by the clocks of two machines";
    TOPIC_HANDLING: gauge "gdp_topic_handling_seconds" ["graph", "topic", "direction", "percentile"] "Time to process one of the latest 1024 messages";
    CERTIFICATE: gauge "gdp_certificate_expiry_timestamp_seconds" ["graph", "topic", "direction"] "When the certificate of a topic, service or action ends";
    CALLS: counter "gdp_service_calls" ["graph", "service", "direction"] "Calls of a service or action";
    ANSWERS: counter "gdp_service_answers" ["graph", "service", "direction"] "Answered calls of a service or action";
    SERVERS: gauge "gdp_service_servers" ["graph", "service", "direction"] "Servers that can be called";
    PENDING: gauge "gdp_service_pending_calls" ["graph", "service", "direction"] "Calls that wait for an answer";
    LINK_UP: gauge "gdp_proxy_link_up" ["target"] "Whether a link of the configuration is up";
    LINK_SENT: counter "gdp_proxy_link_sent_frames" ["target"] "Frames sent on a link, copies among them";
    LINK_UNSENT: counter "gdp_proxy_link_unsent_frames" ["target"] "Frames that a link did not take";
    LINK_COPIES: counter "gdp_proxy_link_copies" ["target", "outcome"] "Copies of frames that the main link carried as well";
    NODE_MESSAGES: counter "gdp_node_messages" ["outcome"] "Messages of the proxy's node in the fabric";
    NODE_FRAMES: counter "gdp_node_frames" ["outcome"] "Frames of the proxy's node in the fabric";
    NODE_LINKS: counter "gdp_node_links" [] "Links made so far: all but the first of each lane are reconnections";
    NODE_FEEDBACK: counter "gdp_node_feedback" ["direction"] "Feedback between readers and writers";
    NODE_ERRORS: counter "gdp_node_received_errors" ["code"] "Errors of the switch about frames of this node";
    NODE_DROPS: counter "gdp_node_dropped" ["reason"] "Frames, segments and messages dropped on arrival, by reason";
}

/// A graph, a topic or service in it, and the direction.
type LabelKey<'a> = (&'a str, &'a str, &'static str);

pub fn exposition(status: &ProxyReply) -> Exposition {
    let mut all = Exposition::default();
    all.add(&BUILD, [env!("CARGO_PKG_VERSION")], 1);
    all.add(&ATTACHED, [], status.switch.is_some().into());
    if status.member_until.is_some() || status.member_error.is_some() {
        all.add(&MEMBERSHIP_VALID, [], status.member_error.is_none().into());
        status.member_until.iter().for_each(|until| all.add(&MEMBERSHIP_EXPIRY, [], *until));
    }
    if let Some(directory) = &status.directory {
        all.add(&DIRECTORY_UP, [], (directory.status == UP).into());
    }
    states(&mut all, status);
    let mut dropped = BTreeMap::new();
    for (reason, count) in status.topics.iter().flat_map(|topic| &topic.drops) {
        *dropped.entry(reason.as_str()).or_default() += count;
    }
    dropped.iter().for_each(|(reason, count)| all.add(&DROPS, [reason], *count));
    let mut failed = BTreeMap::new();
    for (reason, count) in status.calls.iter().flat_map(|call| &call.failures) {
        *failed.entry(reason.as_str()).or_default() += count;
    }
    failed.iter().for_each(|(reason, count)| all.add(&FAILURES, [reason], *count));
    let topics = status.topics.iter().map(|topic| ((&*topic.graph, &*topic.topic, topic.direction.as_str()), topic));
    for (key, topics) in grouped(topics, |topic| topic.messages) {
        self::topic(&mut all, key, &topics);
    }
    let calls = status.calls.iter().map(|call| ((&*call.graph, &*call.service, call.direction.as_str()), call));
    for ((graph, service, direction), calls) in grouped(calls, |call| call.calls) {
        let labels = [graph, service, direction];
        let sum = |of: fn(&ProxyCall) -> u64| calls.iter().map(|call| of(call)).sum();
        all.add(&CALLS, labels, sum(|call| call.calls));
        all.add(&ANSWERS, labels, sum(|call| call.answers));
        all.add(&SERVERS, labels, sum(|call| call.servers));
        all.add(&PENDING, labels, sum(|call| call.pending));
        if let Some(until) = calls.iter().filter_map(|call| call.certificate_until).min() {
            all.add(&CERTIFICATE, labels, until);
        }
    }
    links_and_node(&mut all, status);
    all
}

/// The status of a route that carries.
const UP: &str = "up";

/// Counts topics and calls by state. What routes wait for is a closed set.
fn states(all: &mut Exposition, status: &ProxyReply) {
    let topics = status.topics.iter().map(|topic| ("topic", &topic.status, &topic.waiting_for));
    let calls = status.calls.iter().map(|call| ("call", &call.status, &call.waiting_for));
    let mut counts = BTreeMap::from([(("topic", UP), 0), (("call", UP), 0)]);
    for (kind, status, waiting) in topics.chain(calls) {
        let state = match waiting {
            Some(waiting) => waiting,
            None if status == UP => UP,
            None => OTHER,
        };
        *counts.entry((kind, state)).or_default() += 1;
    }
    counts.iter().for_each(|((kind, state), count)| all.add(&ROUTES, [kind, state], *count));
}

/// Groups what has the same labels. The busiest groups keep their labels, and all others are one.
fn grouped<'a, T>(
    items: impl Iterator<Item = (LabelKey<'a>, &'a T)>,
    traffic: impl Fn(&T) -> u64,
) -> BTreeMap<LabelKey<'a>, Vec<&'a T>> {
    let mut groups: BTreeMap<LabelKey, Vec<&T>> = BTreeMap::new();
    items.for_each(|(key, item)| groups.entry(key).or_default().push(item));
    if groups.len() <= MAX_SERIES {
        return groups;
    }
    let mut by_traffic: Vec<_> = groups.into_iter().collect();
    by_traffic.sort_by_key(|(_, items)| std::cmp::Reverse(items.iter().map(|item| traffic(item)).sum::<u64>()));
    let others = by_traffic.split_off(MAX_SERIES);
    let mut groups: BTreeMap<_, _> = by_traffic.into_iter().collect();
    for ((_, _, direction), items) in others {
        groups.entry((OTHER, OTHER, direction)).or_default().extend(items);
    }
    groups
}

fn topic(all: &mut Exposition, (graph, topic, direction): LabelKey, of: &[&ProxyTopic]) {
    let labels = [graph, topic, direction];
    let sum = |count: fn(&ProxyTopic) -> u64| of.iter().map(|topic| count(topic)).sum();
    all.add(&TOPIC_MESSAGES, labels, sum(|topic| topic.messages));
    all.add(&TOPIC_BYTES, labels, sum(|topic| topic.bytes));
    all.add(&TOPIC_CARRIED, labels, sum(|topic| topic.bytes_carried));
    all.add(&TOPIC_LOST, labels, sum(ProxyTopic::lost));
    all.add(&TOPIC_UP, labels, of.iter().all(|topic| topic.status == UP && topic.waiting_for.is_none()).into());
    if let Some(readers) = of.iter().filter_map(|topic| topic.readers()).max() {
        all.add(&TOPIC_READERS, labels, readers as u64);
    }
    let slowest = |stage: fn(&ProxyTopic) -> Option<StagePercentiles>| {
        of.iter().filter_map(|topic| stage(topic)).max_by_key(|times| times.p99)
    };
    let stages = [
        (&TOPIC_AGE, slowest(|topic| topic.latency_us.arrival)),
        (&TOPIC_HANDLING, slowest(|topic| topic.latency_us.handling)),
    ];
    for (metric, times) in stages {
        let Some(times) = times else { continue };
        for (percentile, micros) in [("50", times.p50), ("99", times.p99)] {
            all.add_real(metric, [graph, topic, direction, percentile], f64::from(micros) / 1e6);
        }
    }
    if let Some(until) = of.iter().filter_map(|topic| topic.certificate_until).min() {
        all.add(&CERTIFICATE, labels, until);
    }
}

fn links_and_node(all: &mut Exposition, status: &ProxyReply) {
    for link in &status.links {
        all.add(&LINK_UP, [&link.target], (link.state == FabricLinkState::Up).into());
        all.add(&LINK_SENT, [&link.target], link.frames_sent);
        all.add(&LINK_UNSENT, [&link.target], link.frames_unsent);
        all.add(&LINK_COPIES, [&link.target, "sent"], link.copies_sent);
        all.add(&LINK_COPIES, [&link.target, "dropped"], link.copies_dropped);
    }
    let node = &status.node;
    let messages =
        [("sent", node.messages_sent), ("unsent", node.messages_unsent), ("received", node.messages_received)];
    messages.iter().for_each(|(outcome, count)| all.add(&NODE_MESSAGES, [outcome], *count));
    let frames = [("sent", node.frames_sent), ("unsent", node.frames_unsent), ("received", node.frames_received)];
    frames.iter().for_each(|(outcome, count)| all.add(&NODE_FRAMES, [outcome], *count));
    all.add(&NODE_LINKS, [], node.links);
    all.add(&NODE_FEEDBACK, ["sent"], node.feedback_sent);
    all.add(&NODE_FEEDBACK, ["received"], node.feedback_received);
    node.errors_received.iter().for_each(|(code, count)| all.add(&NODE_ERRORS, [code], *count));
    node.drops.iter().for_each(|(reason, count)| all.add(&NODE_DROPS, [reason], *count));
}

#[cfg(test)]
#[path = "../tests/unit/metrics.rs"]
mod tests;
