//! Unit tests of `cli::home::join_metrics`.

use gdp_core::identity::SigningKey;
use gdp_directory::messages::{Application, JoinRequest};
use gdp_directory::service::JoinService;
use gdp_http::HttpRequest;
use gdp_tests::book::reference::{self, page, table, wrapped};
use gdp_wire::Name;

use super::*;

fn scraped(metrics: &JoinMetrics) -> String {
    let request = HttpRequest { path: PATH.into(), query: String::new(), accept: None };
    String::from_utf8(metrics.exposition().response(&request).body.to_vec()).unwrap()
}

#[test]
fn applicants_and_replies_are_counted() {
    let mut service = JoinService::new(SigningKey::generate().unwrap(), Name::from_bytes([1; 32]));
    let metrics = JoinMetrics::default();
    metrics.update(&service.directory(0), service.applications().len());
    assert!(scraped(&metrics).contains("gdp_join_members{state=\"pending\"} 0"), "{}", scraped(&metrics));
    for (entity, label) in [(2, "robot7"), (3, "no label!")] {
        let (expose, import, read) = Default::default();
        let key = SigningKey::generate().unwrap().verify_key();
        let application = Application { key, label: label.into(), expose, import, read };
        let request = JoinRequest::Apply(Box::new(application));
        metrics.replied(&service.answer(Name::from_bytes([entity; 32]), request, 0));
    }
    metrics.update(&service.directory(0), service.applications().len());
    metrics.write_failed();
    let scraped = scraped(&metrics);
    for line in [
        "gdp_join_members{state=\"joined\"} 0",
        "gdp_join_members{state=\"pending\"} 1",
        "gdp_join_replies_total{outcome=\"pending\"} 1",
        "gdp_join_replies_total{outcome=\"refused\"} 1",
        "gdp_join_failed_writes_total 1",
    ] {
        assert!(scraped.contains(line), "{line} is not in {scraped}");
    }
    assert!(!scraped.contains("gdp_join_first_membership_expiry"), "nobody is a member");
}

#[test]
fn the_reference_page_has_every_metric() {
    let introduction = "`gdp-ctl join-service --metrics 9406` serves these, and so does the service that `gdp-ctl up` \
                        starts with `GDP_JOIN_METRICS=9406` in its environment. [Metrics](metrics.md) has those of \
                        switches and proxies.";
    let row = |metric: &&gdp_http::metrics::Metric| {
        let labels: Vec<_> = metric.labels.iter().map(|label| format!("`{label}`")).collect();
        vec![format!("`{}`", metric.sample_name()), labels.join(", "), metric.help.into()]
    };
    let rows: Vec<_> = ALL.iter().map(row).collect();
    let body = wrapped(introduction) + &table(&["metric", "labels", "meaning"], &rows);
    reference::check("docs/reference/metrics-join-service.md", &page("Metrics of the join service", &body));
}
