//! The screen of `top`, from samples that no program sent.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use gdp_wire::Name;
use serde_json::{Value, json};

use super::super::sample::RobotState;
use super::super::screen::{render, text};
use super::*;

fn topic(topic: &str, messages: u64, lost: u64, age: u32, waiting: Option<&str>) -> Value {
    json!({"topic": topic, "graph": "ros2", "type": null, "status": "up", "waiting_for": waiting,
        "certificate_until": null, "direction": "out", "name": Name::from_bytes([7; 32]), "messages": messages,
        "direct": 0, "bytes": messages * 500_000, "bytes_carried": 0, "drops": {"lost": lost},
        "latency_us": {"arrival": {"p50": 1, "p99": age}, "handling": null},
        "fabric": {"messages": messages, "replaced": 0, "expired": 0, "evicted": 0, "frames": 0, "repeated": 0,
            "over_budget": 0, "marked": 0, "slowed": 0, "readers": 2, "incompatible_readers": 0, "refused": {}}})
}

fn proxy(topics: &[Value]) -> Box<ProxyReply> {
    let reply = json!({"version": 5, "entity": Name::from_bytes([1; 32]), "switch": Name::from_bytes([2; 32]),
        "member_until": null, "member_error": null, "topics": topics, "catalogs": [], "directory": null, "calls": [],
        "links": [], "node": {"messages_sent": 0, "messages_unsent": 0, "messages_received": 0, "frames_sent": 0,
            "frames_unsent": 0, "frames_received": 0, "links": 1, "errors_received": {}, "echoes_answered": 0,
            "feedback_sent": 0, "feedback_received": 0, "drops": {}}});
    serde_json::from_value(reply).unwrap()
}

fn switch(sent: u64, dropped: u64) -> Box<StatusReply> {
    let name = Name::from_bytes([2; 32]);
    let link = json!({"peer": Name::from_bytes([3; 32]), "role": "switch", "lane": 0, "relationship": "member",
        "domain": null, "admitted_until": null, "via": "udp 192.0.2.1:31415", "address": "192.0.2.1:31415", "id": 1,
        "mtu": 1400, "key_generations": {"rx": 0, "tx": 0}, "cost": 1, "rtt_us": 23000, "age_s": 5,
        "errors_received": {}, "arrivals": {"forwarded": sent, "drop_no_route": dropped}, "traces_refused": 0,
        "sent": sent, "carrier": true, "answers": true, "plane": "userspace"});
    let status = json!({"name": name, "data_plane": "userspace", "data_plane_reason": "", "interfaces": [],
        "dpdk_processor_time_us": [], "udp": null, "links": [link], "links_in_grace": [],
        "handshakes": {"challenged": 0, "refused": 0, "displaced": 0, "failed": 0}, "refused": [], "refused_total": {},
        "counters": {"forwarded": sent, "drop_no_route": dropped, "drop_stale": 0}, "counters_by_plane": {},
        "busiest": [{"name": Name::from_bytes([9; 32]), "frames": sent}],
        "fib": {"names": 3, "generation": 1, "own_bit": null}, "topology": {"switches": 2, "reached": 1}, "rib": null,
        "domain": null, "control": {"rib": null, "next": null, "fenced": 0, "ready": false, "reason": "no path"},
        "tiers": null, "warnings": [], "errors": []});
    Box::new(serde_json::from_value(status).unwrap())
}

fn sample(at: Instant, proxy: Option<Box<ProxyReply>>, switch: Option<Box<StatusReply>>) -> TopSample {
    TopSample { at, switch, proxy, paths: BTreeMap::new(), robots: Vec::new(), problem: None }
}

/// Two samples, two seconds apart.
fn samples() -> (TopSample, TopSample) {
    let start = Instant::now();
    let at = start + Duration::from_secs(2);
    let before = [topic("/camera", 100, 5, 41_000, None), topic("/scan", 10, 0, 900, None)];
    let now = [topic("/camera", 160, 5, 41_000, None), topic("/scan", 30, 2, 900, None)];
    (sample(start, Some(proxy(&before)), Some(switch(100, 0))), sample(at, Some(proxy(&now)), Some(switch(300, 4))))
}

#[test]
fn rates_are_the_difference_of_two_samples() {
    let (before, mut now) = samples();
    now.paths = [(Name::from_bytes([7; 32]), "here,030…303".to_owned())].into();
    now.robots = vec![RobotState { label: "robot7".into(), state: "online".into(), expose: "/camera".into() }];
    let lines = text(&Model::new(Some(&before), &now, SortKey::Messages), 140);
    let find = |word: &str| {
        let line = lines.iter().find(|line| line.starts_with(word)).unwrap_or_else(|| panic!("{word}: {lines:#?}"));
        line.split_whitespace().collect::<Vec<_>>()
    };
    assert_eq!(find("/camera"), ["/camera", "out", "30.0", "15.0", "5", "41", "ms", "2", "here,030…303", "up"]);
    assert_eq!(find("/scan"), ["/scan", "out", "10.0", "5.0", "2!", "0.9", "ms", "2", "here,030…303", "up"]);
    assert_eq!(find("030…303")[1..], ["switch", "udp", "192.0.2.1:31415", "23.0", "ms", "100.0", "102.0", "2.0"]);
    assert_eq!(find("drop_no_route"), ["drop_no_route", "2.0", "4"]);
    assert_eq!(find("090…909"), ["090…909", "100.0", "300", "–"]);
    assert_eq!(find("robot7"), ["robot7", "online", "/camera"]);
    assert_eq!(find("RIB"), ["RIB", "not", "reached:", "no", "path"]);
    assert!(lines[0].contains("1 of 1 robots online") && lines[0].contains("1 of 2 switches reached"), "{}", lines[0]);
    assert!(!lines.iter().any(|line| line.contains("drop_stale")), "{lines:#?}");
    // The proxy knows what the switch's busiest name is, and a few bytes are not zero.
    now.switch.as_mut().unwrap().busiest[0].name = Name::from_bytes([7; 32]);
    now.proxy.as_mut().unwrap().topics[1].bytes = before.proxy.as_ref().unwrap().topics[1].bytes + 78_000;
    let lines = text(&Model::new(Some(&before), &now, SortKey::Messages), 120);
    assert!(lines.iter().any(|line| line.starts_with("070…707") && line.ends_with("/scan")), "{lines:#?}");
    assert!(lines.iter().any(|line| line.starts_with("/scan") && line.contains(" 0.039 ")), "{lines:#?}");
}

#[test]
fn without_an_earlier_sample_or_after_a_restart_there_is_no_rate() {
    let (before, now) = samples();
    for model in [Model::new(None, &before, SortKey::Name), Model::new(Some(&now), &before, SortKey::Name)] {
        let lines = text(&model, 120);
        let camera = lines.iter().find(|line| line.starts_with("/camera")).unwrap();
        assert!(camera.split_whitespace().nth(2) == Some("–"), "{camera}");
    }
}

#[test]
fn keys_change_the_order() {
    let (before, now) = samples();
    let first = |sort| {
        let model = Model::new(Some(&before), &now, sort);
        model.grids[0].rows[0].1[0].clone()
    };
    let orders = ['m', 'b', 'l', 'a', 'n'].map(|key| first(SortKey::of(key).unwrap()));
    assert_eq!(orders, ["/camera"; 5]);
    let mut now = now;
    let scan = &mut now.proxy.as_mut().unwrap().topics[1];
    (scan.messages, scan.bytes) = (100_000, 1);
    scan.drops.insert("lost".into(), 50);
    let first = |sort| Model::new(Some(&before), &now, sort).grids[0].rows[0].1[0].clone();
    assert_eq!(
        ['m', 'b', 'l', 'a'].map(|key| first(SortKey::of(key).unwrap())),
        ["/scan", "/camera", "/scan", "/camera"]
    );
    assert_eq!(SortKey::of('x'), None);
}

#[test]
fn a_small_screen_says_how_many_rows_it_leaves_out() {
    let topics: Vec<_> = (0..500).map(|i| topic(&format!("/t{i}"), i, 0, 1, None)).collect();
    let now = sample(Instant::now(), Some(proxy(&topics)), Some(switch(1, 1)));
    let model = Model::new(None, &now, SortKey::Messages);
    for (width, height) in [(120, 40), (80, 24), (60, 10), (20, 5), (1, 1), (400, 200)] {
        let lines = render(&model, width, height);
        assert_eq!(lines.len(), usize::from(height));
        assert!(lines.iter().all(|line| line.chars().count() <= usize::from(width)));
    }
    let lines = render(&model, 100, 40);
    assert!(lines.iter().any(|line| line.starts_with("and 4")), "{lines:#?}");
    assert!(lines.iter().any(|line| line.starts_with("LINK TO")), "{lines:#?}");
    assert!(lines[39].contains("q ends"), "{lines:#?}");
}

#[test]
fn hostile_text_does_not_reach_the_terminal() {
    let mut one = topic("/a\u{1b}[2J\nb", 1, 0, 1, Some("local\u{7}publisher"));
    one["status"] = "up".into();
    let mut now = sample(Instant::now(), Some(proxy(&[one])), None);
    now.problem = Some("the \u{9b}daemon".into());
    now.robots = vec![RobotState { label: "r\u{202e}x".into(), state: "pending".into(), expose: "\r/x".into() }];
    let lines = text(&Model::new(None, &now, SortKey::Messages), 200);
    let all = lines.concat();
    assert!(!all.contains(|c: char| c.is_control() || c == '\u{202e}'), "{all:?}");
    assert!(all.contains("/a") && all.contains("pending") && all.contains("daemon"), "{all}");
}

#[test]
fn a_program_that_ends_leaves_its_reason() {
    let failed = TopSample::failed(&anyhow::anyhow!("no daemon answers"));
    let lines = text(&Model::new(None, &failed, SortKey::Messages), 80);
    assert_eq!(lines, ["gdp-ctl top", "no daemon answers"]);
}
