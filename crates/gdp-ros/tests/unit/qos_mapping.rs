//! Unit tests of `qos_mapping`.

use super::*;

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
fn best_effort_keeps_the_depth() {
    let publish = publish_options(&BEST_EFFORT);
    assert!(matches!(publish.reliability, Reliability::BestEffort { .. }));
    assert_eq!((publish.history, publish.latched), (3, 0));
}

#[test]
fn reliable_repairs_what_was_sent_lately_and_never_waits() {
    for (depth, keep_last, history) in [(10, 10, REPAIRABLE), (5000, 5000, 5000), (0, ALL, ALL)] {
        let publish = publish_options(&Offer { reliable: true, depth, ..BEST_EFFORT });
        assert_eq!(publish.reliability, Reliability::Reliable { overflow: Overflow::DropOldest { keep_last } });
        assert_eq!((publish.history, publish.latched), (history, 0));
    }
}

#[test]
fn transient_local_gives_late_readers_the_depth() {
    let latching = Offer { transient_local: true, depth: 7, ..BEST_EFFORT };
    assert_eq!((latched_depth(&latching), latched_depth(&BEST_EFFORT)), (7, 0));
    assert_eq!(publish_options(&latching).latched, 0, "it is nobody else's");
}

#[test]
fn a_name_is_published_anew_only_for_what_it_lacks() {
    let reliable = Offer { reliable: true, depth: 10, ..BEST_EFFORT };
    let latching = Offer { transient_local: true, depth: 1, ..reliable };
    assert!(!exceeds(&latching, &reliable) && !exceeds(&reliable, &latching) && !exceeds(&BEST_EFFORT, &reliable));
    assert!(exceeds(&reliable, &BEST_EFFORT) && exceeds(&Offer { depth: 0, ..reliable }, &reliable));
}

#[test]
fn of_several_publishers_the_most_is_taken() {
    let latched = Offer { transient_local: true, depth: 1, ..BEST_EFFORT };
    let reliable = Offer { reliable: true, depth: 0, ..BEST_EFFORT };
    let all = merged(merged(latched, reliable), BEST_EFFORT);
    assert_eq!((all.reliable, all.transient_local, all.depth), (true, true, 0));
    assert_eq!(merged(latched, BEST_EFFORT).depth, 3);
}
