//! Unit tests of `stats`.

use std::time::Duration;

use gdp::unstable::LinkState;

use gdp_tests::book::reference::{self, page, table, wrapped};
use gdp_wire::Counter;

use super::*;
use crate::call::Reason as CallReason;
use crate::config::What;
use crate::tally::Reason;

/// Of version 5.
const KEYS: [&str; 10] = [
    "calls catalogs clocks directory entity links member_error member_until node switch topics version",
    "bytes bytes_carried certificate_until direct direction drops fabric graph latency_us messages name status topic type \
     waiting_for",
    "crowded lost malformed max_hz no_counterpart own send_failed stalled unannounced unconvertible unreadable \
     write_failed",
    "arrival handling",
    "p50 p99",
    "copies_dropped copies_sent frames_sent frames_unsent main reason state switch target",
    "drops echoes_answered errors_received feedback_received feedback_sent frames_received \
     frames_sent frames_unsent links messages_received messages_sent messages_unsent",
    "evicted expired frames incompatible_readers marked messages over_budget readers refused \
     repeated replaced slowed",
    "abandoned beyond delivered drops duplicates expired incompatible_writers overtaken \
     queue_full repeats",
    "answers answers_by_other calls calls_replicated certificate_until copies_cancelled direction events \
     events_dropped failures graph name pending servers service status type waiting_for what",
];

#[test]
fn the_fabrics_counters_are_shown_as_they_are() {
    let mut counters = SubscriptionCounters::default();
    counters.inbound.delivered = 7;
    counters.incompatible_writers = 1;
    counters.drops.insert("seal_too_old", 3);
    let shown = serde_json::to_value(FabricStats::In(counters)).unwrap();
    assert_eq!((&shown["delivered"], &shown["drops"]["seal_too_old"]), (&7.into(), &3.into()));
    assert_eq!(shown["incompatible_writers"], 1);
    let shown = serde_json::to_value(FabricStats::Out(PublisherCounters::default())).unwrap();
    assert_eq!((&shown["frames"], &shown["incompatible_readers"]), (&0.into(), &0.into()));
}

fn route(name: Name, counters: &RouteCounters) -> RouteStats {
    RouteStats {
        topic: "/chatter".into(),
        graph: "ros2".into(),
        kind: None,
        status: "up".into(),
        waiting_for: None,
        certificate_until: None,
        direction: Side::Out,
        name,
        fabric: FabricStats::None,
        counted: counters.read(),
    }
}

/// Who reads the file relies on them: another [`VERSION`] for others.
#[test]
fn the_keys_are_those_of_the_version() {
    let (name, counters) = (Name::from_bytes([7; 32]), RouteCounters::default());
    counters.arrival.record(Duration::from_millis(1));
    let route = route(name, &counters);
    let link = LinkStatus {
        target: "eth://r0".into(),
        state: LinkState::Up,
        reason: None,
        main: true,
        switch: None,
        frames_sent: 0,
        frames_unsent: 0,
        copies_sent: 0,
        copies_dropped: 0,
    };
    let call = CallStats {
        what: What::Action,
        service: "/move".into(),
        graph: "ros2".into(),
        kind: None,
        status: "up".into(),
        waiting_for: None,
        certificate_until: None,
        direction: Side::In,
        name,
        counted: Default::default(),
    };
    let (topics, calls, links, node) = (vec![route], vec![call], vec![link], NodeCounters::default());
    let stats = Stats {
        version: VERSION,
        entity: name,
        switch: None,
        member_until: None,
        member_error: None,
        topics,
        directory: None,
        catalogs: vec![],
        calls,
        links,
        clocks: vec![],
        node,
    };
    let shown = serde_json::to_value(stats).unwrap();
    let keys = |of: &serde_json::Value| of.as_object().unwrap().keys().cloned().collect::<Vec<_>>().join(" ");
    let of_fabric = |of: FabricStats| keys(&serde_json::to_value(of).unwrap());
    let topic = &shown["topics"][0];
    let found = [
        keys(&shown),
        keys(topic),
        keys(&topic["drops"]),
        keys(&topic["latency_us"]),
        keys(&topic["latency_us"]["arrival"]),
        keys(&shown["links"][0]),
        keys(&shown["node"]),
        of_fabric(FabricStats::Out(PublisherCounters::default())),
        of_fabric(FabricStats::In(SubscriptionCounters::default())),
        keys(&shown["calls"][0]),
    ];
    assert_eq!((VERSION, found), (5, KEYS.map(str::to_owned)));
    // The admin socket has the same object.
    let fabrics = [
        FabricStats::None,
        FabricStats::Out(PublisherCounters::default()),
        FabricStats::In(SubscriptionCounters::default()),
    ];
    for fabric in fabrics {
        let mut shown = shown.clone();
        shown["topics"][0]["fabric"] = serde_json::to_value(fabric).unwrap();
        let reply: gdp_proto::admin::proxy::ProxyReply = serde_json::from_value(shown.clone()).unwrap();
        assert_eq!(serde_json::to_value(reply).unwrap(), shown);
    }
}

#[test]
fn the_file_is_whole_and_says_what_happened() {
    let folder = tempfile::tempdir().unwrap();
    let file = StatsFile::new(folder.path().join("stats.json"));
    let counters = RouteCounters::default();
    for sent in 1..=2 {
        counters.passed(68, 17);
        let name = Name::from_bytes([7; 32]);
        let route = route(name, &counters);
        let topics = vec![route];
        file.replace(&Stats {
            version: VERSION,
            entity: name,

            switch: None,
            member_until: None,
            member_error: None,
            topics,
            catalogs: Vec::new(),
            directory: None,
            calls: Vec::new(),
            links: Vec::new(),
            clocks: Vec::new(),
            node: NodeCounters::default(),
        })
        .unwrap();
        let read: serde_json::Value = serde_json::from_slice(&std::fs::read(file.path()).unwrap()).unwrap();
        let topic = &read["topics"][0];
        assert_eq!((&topic["messages"], &topic["bytes"]), (&sent.into(), &(68 * sent).into()));
        assert_eq!(topic["bytes_carried"], 17 * sent);
        assert_eq!((&topic["direction"], &topic["name"]), (&"out".into(), &"07".repeat(32).into()));
        assert_eq!((&topic["drops"]["send_failed"], &topic["fabric"]), (&0.into(), &serde_json::Value::Null));
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn the_reference_page_has_every_counter() {
    let section = |title: &str, text: &str, rows: Vec<Vec<String>>| {
        format!("## {title}\n\n{}{}", wrapped(text), table(&["counter", "meaning"], &rows))
    };
    let row = |name: &str, about: &str| vec![format!("`{name}`"), with_counter_names(about)];
    let body = section(
        "Frames at a switch",
        "`gdp-ctl status` and `gdp-ctl xdp stats` show these. Every frame and every copy is counted in exactly one. A \
         frame that is lost afterwards is also counted as `drop_redirect_lost`.",
        Counter::ALL.iter().map(|counter| row(counter.as_str(), counter.about())).collect(),
    ) + &section(
        "Segments and messages at a reader",
        "The proxy's statistics (`gdp-proxy --stats FILE`) have these under `fabric` of each topic that comes in.",
        gdp_e2e::seal::DropReason::ALL.iter().map(|reason| row(reason.label(), reason.about())).collect(),
    ) + &section(
        "Messages of topics at a proxy",
        "The proxy's statistics have these under `drops` of each topic. The log names each reason once for a topic.",
        Drop::ALL.iter().map(|reason| row(reason.as_str(), reason.about())).collect(),
    ) + &section(
        "Calls at a proxy",
        "The proxy's statistics have these under `failures` of each service and action.",
        CallReason::ALL.iter().map(|reason| row(reason.as_str(), reason.about())).collect(),
    );
    reference::check("docs/reference/counters.md", &page("Counters and drop reasons", &body));
}

/// Replaces Rust's names of counters by those that users see.
fn with_counter_names(about: &str) -> String {
    Counter::ALL.iter().fold(about.to_owned(), |about, counter| {
        about.replace(&format!("[`Counter::{counter:?}`]"), &format!("`{}`", counter.as_str()))
    })
}
