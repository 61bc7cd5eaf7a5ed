//! Unit tests of `graph::ros2`.

use super::*;

#[test]
fn what_is_asked_for_and_not_offered_is_named() {
    let least = Offer {
        reliable: false,
        transient_local: false,
        depth: 1,
        deadline_ns: 0,
        lifespan_ns: 0,
        liveliness_ns: 0,
        manual_liveliness: false,
    };
    let most = Offer {
        reliable: true,
        transient_local: true,
        deadline_ns: 5,
        lifespan_ns: 5,
        liveliness_ns: 5,
        manual_liveliness: true,
        ..least
    };
    assert_eq!((lacking(&most, &least), lacking(&most, &most), lacking(&least, &least)), (None, None, None));
    for (asked, policy) in [
        (Offer { reliable: true, ..least }, "reliability"),
        (Offer { transient_local: true, ..least }, "durability"),
        (Offer { deadline_ns: 9, ..least }, "deadline"),
        (Offer { liveliness_ns: 9, ..least }, "liveliness"),
        (Offer { manual_liveliness: true, ..least }, "liveliness"),
    ] {
        assert_eq!((lacking(&least, &asked), lacking(&most, &asked)), (Some(policy), None));
    }
    assert_eq!(lacking(&most, &Offer { deadline_ns: 4, ..most }), Some("deadline"));
}
