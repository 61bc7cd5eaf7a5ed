//! The text formats.

use super::*;

static SENT: Metric = Metric::counter("gdp_frames", &["peer"], "Frames sent");
static AGE: Metric = Metric::gauge("gdp_age_seconds", &[], "Age of the newest message");

fn scrape(accept: Option<&str>) -> (String, &'static str) {
    let mut exposition = Exposition::default();
    exposition.add(&SENT, ["a\"\n\\b"], u64::MAX);
    exposition.add_real(&AGE, [], 0.25);
    exposition.add(&SENT, ["c"], 1);
    let request = HttpRequest { path: PATH.into(), query: String::new(), accept: accept.map(ToOwned::to_owned) };
    let response = exposition.response(&request);
    (String::from_utf8(response.body.to_vec()).unwrap(), response.content_type)
}

#[test]
fn prometheus_gets_its_old_format_unless_it_asks_for_the_new_one() {
    let (body, content_type) = scrape(None);
    assert_eq!(
        body,
        "# HELP gdp_frames_total Frames sent\n# TYPE gdp_frames_total counter\n\
         gdp_frames_total{peer=\"a\\\"\\n\\\\b\"} 18446744073709551615\ngdp_frames_total{peer=\"c\"} 1\n\
         # HELP gdp_age_seconds Age of the newest message\n# TYPE gdp_age_seconds gauge\ngdp_age_seconds 0.25\n"
    );
    assert!(content_type.contains("version=0.0.4"));
}

#[test]
fn open_metrics_has_an_end() {
    let (body, content_type) = scrape(Some("application/openmetrics-text;version=1.0.0,text/plain;q=0.5"));
    assert!(body.contains("# TYPE gdp_frames counter\ngdp_frames_total{") && body.ends_with("# EOF\n"), "{body}");
    assert!(content_type.contains("openmetrics-text"));
}
