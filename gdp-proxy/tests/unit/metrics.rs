//! The metrics of a proxy say what its statistics say; the dashboard and the alerts ask for metrics
//! that exist.

use std::collections::BTreeSet;

use gdp_http::HttpRequest;
use gdp_http::metrics::{Metric, MetricKind, PATH};
use gdp_tests::book::reference::{self, page, table, wrapped};
use gdp_tests::book::root;
use gdp_tests::programs::{Executable as _, Program};
use gdp_wire::Name;
use serde_json::{Value, json};

use super::*;

fn topic(i: usize) -> Value {
    let name = Name::from_bytes([7; 32]);
    json!({"topic": format!("/t{i}"), "graph": "ros2", "type": null, "status": "up", "waiting_for": null,
        "certificate_until": 5000 + i, "direction": "in", "name": name, "messages": 10, "direct": 0, "bytes": 100,
        "bytes_carried": 50, "drops": {"malformed": 1, "max_hz": 4},
        "latency_us": {"arrival": {"p50": 1000, "p99": 250000}, "handling": null},
        "fabric": {"delivered": 10, "overtaken": 2, "expired": 0, "abandoned": 0, "duplicates": 0, "beyond": 0,
            "queue_full": 0, "repeats": 0, "incompatible_writers": 0, "drops": {}}})
}

fn status(topics: usize) -> ProxyReply {
    serde_json::from_value(json!({
        "version": 5, "entity": Name::from_bytes([1; 32]), "switch": null, "member_until": 1234, "member_error": null,
        "topics": (0..topics).map(topic).collect::<Vec<_>>(), "catalogs": [], "directory": null,
        "calls": [{"what": "service", "service": "/s", "graph": "ros2", "type": null, "status": "starting",
            "waiting_for": "remote_server", "certificate_until": null, "direction": "in",
            "name": Name::from_bytes([2; 32]), "calls": 3, "answers": 2, "failures": {"left": 1}, "pending": 1,
            "servers": 0, "calls_replicated": 0, "copies_cancelled": 0, "answers_by_other": 0, "events": 0,
            "events_dropped": 0}],
        "links": [{"target": "udp://h", "state": "down", "reason": "no answer", "main": false, "switch": null,
            "frames_sent": 1, "frames_unsent": 2, "copies_sent": 3, "copies_dropped": 4}],
        "node": {"messages_sent": 1, "messages_unsent": 2, "messages_received": 3, "frames_sent": 4, "frames_unsent": 5,
            "frames_received": 6, "links": 7, "errors_received": {"no_route": 8}, "echoes_answered": 9,
            "feedback_sent": 10, "feedback_received": 11, "drops": {"drop_queue_full": 12}},
    }))
    .unwrap()
}

fn scraped(status: &ProxyReply) -> String {
    let request = HttpRequest { path: PATH.into(), query: String::new(), accept: None };
    String::from_utf8(exposition(status).response(&request).body.to_vec()).unwrap()
}

#[test]
fn every_figure_is_that_of_the_statistics() {
    let scraped = scraped(&status(1));
    let of = "graph=\"ros2\",topic=\"/t0\",direction=\"in\"";
    for line in [
        "gdp_proxy_attached 0",
        "gdp_proxy_membership_valid 1",
        "gdp_proxy_membership_expiry_timestamp_seconds 1234",
        "gdp_proxy_routes{kind=\"topic\",state=\"up\"} 1",
        "gdp_proxy_routes{kind=\"call\",state=\"remote_server\"} 1",
        "gdp_proxy_dropped_messages_total{reason=\"max_hz\"} 4",
        "gdp_proxy_failed_calls_total{reason=\"left\"} 1",
        &format!("gdp_topic_messages_total{{{of}}} 10"),
        &format!("gdp_topic_carried_bytes_total{{{of}}} 50"),
        &format!("gdp_topic_lost_messages_total{{{of}}} 3"),
        &format!("gdp_topic_age_seconds{{{of},percentile=\"99\"}} 0.25"),
        &format!("gdp_certificate_expiry_timestamp_seconds{{{of}}} 5000"),
        "gdp_service_calls_total{graph=\"ros2\",service=\"/s\",direction=\"in\"} 3",
        "gdp_proxy_link_up{target=\"udp://h\"} 0",
        "gdp_node_messages_total{outcome=\"received\"} 3",
        "gdp_node_received_errors_total{code=\"no_route\"} 8",
        "gdp_node_dropped_total{reason=\"drop_queue_full\"} 12",
    ] {
        assert!(scraped.lines().any(|found| found == line), "{line}: {scraped}");
    }
}

#[test]
fn too_many_topics_are_summed() {
    let mut status = status(1000);
    // Two names of one topic that is merged.
    status.topics.push(status.topics[0].clone());
    status.topics[500].messages = 1_000_000;
    let scraped = scraped(&status);
    let series: Vec<_> = scraped.lines().filter(|line| line.starts_with("gdp_topic_messages_total{")).collect();
    assert_eq!(series.len(), MAX_SERIES + 1);
    let sum: u64 = series.iter().map(|line| line.rsplit(' ').next().unwrap().parse::<u64>().unwrap()).sum();
    assert_eq!(sum, 1_000_000 + 1000 * 10, "nothing is left out");
    assert!(series.iter().any(|line| line.contains("/t500\"")), "the busiest has its own");
    let names: BTreeSet<_> = scraped.lines().filter_map(|line| line.rsplit_once(' ')).map(|(name, _)| name).collect();
    assert_eq!(names.len(), scraped.lines().count(), "no series is there twice");
}

#[test]
fn the_dashboard_and_the_alerts_ask_for_metrics_that_exist() {
    let metrics: BTreeSet<String> = all().map(Metric::sample_name).collect();
    for file in ["packaging/grafana/gdp.json", "packaging/prometheus/gdp-alerts.yml"] {
        let text = std::fs::read_to_string(root().join(file)).unwrap();
        let words = text.split(|c: char| !c.is_ascii_alphanumeric() && c != '_');
        let asked: BTreeSet<&str> = words.filter(|word| word.starts_with("gdp_")).collect();
        assert!(asked.len() > 10, "{file}: {asked:?}");
        let unknown: Vec<_> = asked.iter().filter(|name| !metrics.contains(**name)).collect();
        assert!(unknown.is_empty(), "{file} asks for {unknown:?}");
    }
    let dashboard = std::fs::read(root().join("packaging/grafana/gdp.json")).unwrap();
    let dashboard: Value = serde_json::from_slice(&dashboard).unwrap();
    assert!(dashboard["panels"].as_array().unwrap().len() > 20);
}

#[test]
fn the_alerts_pass_the_tests_of_promtool() {
    for arguments in [["check", "rules", "gdp-alerts.yml"], ["test", "rules", "gdp-alerts-test.yml"]] {
        let mut command = Program::Promtool.command();
        command.args(arguments).current_dir(root().join("packaging/prometheus"));
        let output = command.output().expect("promtool; `cargo xtask setup` installs it");
        assert!(output.status.success(), "{arguments:?}: {output:?}");
    }
}

#[test]
fn the_reference_page_has_every_metric() {
    let section = |title: &str, text: &str, metrics: &[&Metric]| {
        let row = |metric: &&Metric| {
            let labels: Vec<_> = metric.labels.iter().map(|label| format!("`{label}`")).collect();
            let kind = if metric.kind == MetricKind::Counter { "counter" } else { "gauge" };
            vec![format!("`{}`", metric.sample_name()), kind.into(), labels.join(", "), metric.help.into()]
        };
        let rows: Vec<_> = metrics.iter().map(row).collect();
        format!("## {title}\n\n{}{}", wrapped(text), table(&["metric", "type", "labels", "meaning"], &rows))
    };
    let body = section(
        "A switch",
        "`gdp-ctl serve --metrics 9404` serves these. `peer` is the whole name of the peer. Links of strangers, and \
         those beyond the oldest 200, are summed as `other`.",
        gdp_daemon::serve::metrics::ALL,
    ) + &section(
        "A proxy",
        "`gdp-proxy --metrics 9405` serves these. Topics and services beyond the busiest 200 are summed as `other`.",
        ALL,
    );
    reference::check("docs/reference/metrics.md", &page("Metrics", &body));
}

fn all() -> impl Iterator<Item = &'static Metric> {
    gdp_daemon::serve::metrics::ALL.iter().chain(ALL).copied()
}
