//! Unit tests of `qos_mapping`.

use std::path::Path;

use super::*;
use crate::config::Config;

const BEST_EFFORT: Offer = Offer {
    reliable: false,
    transient_local: false,
    depth: 3,
    deadline_ns: 0,
    lifespan_ns: 0,
    liveliness_ns: 0,
    manual_liveliness: false,
};

#[test]
fn the_topic_gives_priority_and_what_its_reader_waits_for() {
    assert_eq!(publish_options(&BEST_EFFORT, &topic("")).class, 3);
    assert_eq!(publish_options(&BEST_EFFORT, &topic("priority: 7, ")).class, 7);
    assert_eq!(subscribe_options(&topic("qos: {reliability: best_effort}, ")).wants, Wants::Newest);
    let subscribe = subscribe_options(&topic("qos: {depth: 5000}, "));
    assert_eq!((subscribe.wants, subscribe.queue), (Wants::Every, 5000));
    assert_eq!(subscribe_options(&topic("")).wants, Wants::Offered);
}

fn topic(extra: &str) -> TopicConfig {
    let text = format!(
        "{{version: 1, identity: i, links: [{{to: 'eth://r0'}}], \
         topics: [{{topic: /a, {extra}direction: out, card: c, cert: d}}]}}"
    );
    Config::parse(&text, Path::new("p.yaml")).unwrap().topics.remove(0)
}
