use std::time::Duration;

use serde_json::json;

use super::{Exchange, slowest};

#[test]
fn requests_and_replies_of_both_ends_are_joined_by_their_number() {
    let robot = [
        json!({"event": "reply", "id": -1, "received": 5}),
        json!({"event": "request", "id": 0, "sent": 10, "digest": "a"}),
        json!({"event": "request", "id": 1, "sent": 20, "digest": "b"}),
        json!({"event": "reply", "id": 0, "received": 40, "digest": "r"}),
        json!({"event": "request", "id": 2, "sent": 30, "digest": "c"}),
        json!({"event": "done"}),
    ];
    let edge = [
        json!({"event": "compute", "id": -1, "received": 1, "replied": 2, "digest": "x"}),
        json!({"event": "compute", "id": 0, "received": 15, "replied": 35, "digest": "a", "reply_digest": "r"}),
        json!({"event": "compute", "id": 1, "received": 25, "replied": 45, "digest": "other"}),
        json!({"event": "compute", "id": 9, "received": 25, "replied": 45, "digest": "z"}),
    ];
    let joined = Exchange::join(&robot, &edge);
    let times: Vec<_> = joined.iter().map(|it| (it.sent, it.at_edge, it.replied, it.back)).collect();
    let expected =
        [(Some(10), Some(15), Some(35), Some(40)), (Some(20), Some(25), Some(45), None), (Some(30), None, None, None)];
    assert_eq!(times, expected);
    assert_eq!(joined.iter().map(Exchange::is_damaged).collect::<Vec<_>>(), [false, true, false]);
}

#[test]
fn a_reply_that_is_not_what_the_edge_has_written_is_damaged() {
    let robot = [json!({"event": "request", "id": 0, "sent": 1}), json!({"event": "reply", "id": 0, "digest": "a"})];
    let edge = |digest| [json!({"event": "compute", "id": 0, "reply_digest": digest})];
    assert!(Exchange::join(&robot, &edge("b"))[0].is_damaged());
    assert!(!Exchange::join(&robot, &edge("a"))[0].is_damaged());
}

#[test]
fn a_request_that_has_not_arrived_counts_with_its_age() {
    let exchange = |sent, at_edge| Exchange { sent: Some(sent), at_edge, ..Exchange::default() };
    let all = [exchange(0, Some(900)), exchange(100, Some(130)), exchange(200, None)];
    assert_eq!(slowest(&all, 1000, 1250), Duration::from_nanos(1050));
    assert_eq!(slowest(&all[..2], 120, 1250), Duration::from_nanos(900));
    assert_eq!(slowest(&all[1..2], 120, 1250), Duration::from_nanos(30), "it was under way");
    assert_eq!(slowest(&all[..2], 1000, 1250), Duration::ZERO);
}
