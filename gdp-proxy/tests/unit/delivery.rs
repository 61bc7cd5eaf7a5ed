//! Unit tests of `delivery`.

use std::path::Path;

use super::*;
use crate::config::Config;

const BEST_EFFORT: Offer =
    Offer { reliable: false, transient_local: false, depth: 3, deadline_ns: 0, lifespan_ns: 0, liveliness_ns: 0 };

#[test]
fn best_effort_keeps_the_depth_and_asks_for_nothing_again() {
    let publish = publish_options(&BEST_EFFORT, &topic(""));
    assert!(matches!(publish.reliability, Reliability::BestEffort { .. }));
    assert_eq!((publish.history, publish.latched, publish.class), (3, 0, 3));
    assert_eq!(subscribe_options(&topic("qos: {reliability: best_effort}, ")).wants, Wants::Newest);
}

#[test]
fn reliable_repairs_what_was_sent_lately_and_never_waits() {
    for (depth, history) in [(10, REPAIRABLE), (5000, 5000), (0, ALL)] {
        let publish = publish_options(&Offer { reliable: true, depth, ..BEST_EFFORT }, &topic("priority: 7, "));
        assert_eq!(publish.reliability, Reliability::Reliable { overflow: Overflow::DropOldest });
        assert_eq!((publish.history, publish.latched, publish.class), (history, 0, 7));
    }
    let subscribe = subscribe_options(&topic("qos: {depth: 5000}, "));
    assert_eq!((subscribe.wants, subscribe.queue), (Wants::Every, 5000));
    assert_eq!(subscribe_options(&topic("")).wants, Wants::Offered);
}

#[test]
fn transient_local_gives_late_readers_the_depth() {
    let latching = Offer { transient_local: true, depth: 7, ..BEST_EFFORT };
    assert_eq!((latched(&latching), latched(&BEST_EFFORT)), (7, 0));
    assert_eq!(publish_options(&latching, &topic("")).latched, 0, "it is nobody else's");
}

#[test]
fn a_name_is_published_anew_only_for_what_it_lacks() {
    let reliable = Offer { reliable: true, depth: 10, ..BEST_EFFORT };
    let latching = Offer { transient_local: true, depth: 1, ..reliable };
    assert!(!lacks(&reliable, &latching) && !lacks(&latching, &reliable) && !lacks(&reliable, &BEST_EFFORT));
    assert!(lacks(&BEST_EFFORT, &reliable) && lacks(&reliable, &Offer { depth: 0, ..reliable }));
}

#[test]
fn of_several_publishers_the_most_is_taken() {
    let latched = Offer { transient_local: true, depth: 1, ..BEST_EFFORT };
    let reliable = Offer { reliable: true, depth: 0, ..BEST_EFFORT };
    let all = stronger(stronger(latched, reliable), BEST_EFFORT);
    assert_eq!((all.reliable, all.transient_local, all.depth), (true, true, 0));
    assert_eq!(stronger(latched, BEST_EFFORT).depth, 3);
}

fn topic(extra: &str) -> TopicConfig {
    let text = format!(
        "{{version: 1, identity: i, links: [{{to: 'eth://r0'}}], \
         topics: [{{topic: /a, {extra}direction: out, card: c, cert: d}}]}}"
    );
    Config::parse(&text, Path::new("p.yaml")).unwrap().topics.remove(0)
}
