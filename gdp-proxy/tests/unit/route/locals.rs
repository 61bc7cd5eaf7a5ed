//! Unit tests of `route::locals`.

use gdp_e2e::seal::{Encoding, Message};

use super::*;
use gdp_ros::roster::{Dialect, Kind};

#[test]
fn a_roster_that_changes_all_the_time_makes_only_so_many_writers() {
    let start = Instant::now();
    let mut locals = Locals::new(start);
    let mut made = 0;
    for i in 0..10_000 {
        let now = start + Duration::from_millis(i);
        locals.change(now, joined(7, Offer { depth: i as u32, ..OFFER }));
        made += locals.due(now).len();
    }
    assert!((512..=512 + 200).contains(&made), "{made}");
    let taken = (100..1000).filter(|number| locals.change(start, joined(*number, OFFER))).count();
    assert_eq!(taken, MAX_LOCALS - 1);
}

#[test]
fn what_all_latch_together_is_bounded_and_the_largest_lose_their_oldest() {
    let (now, mut locals) = (Instant::now(), Locals::new(Instant::now()));
    let latches = Offer { transient_local: true, depth: 100, ..OFFER };
    let body = bytes::Bytes::from(vec![0; 8 << 20]);
    let mut keep = |number, count| {
        locals.change(now, joined(number, latches));
        let local = locals.get(&Some((WRITER, number))).unwrap();
        (0..count).for_each(|_| local.keep(&message(body.clone())));
        local.bytes()
    };
    let small = keep(0, 1);
    assert_eq!((small, keep(1, 7)), (8 << 20, 56 << 20));
    assert_eq!(keep(2, 9), 64 << 20, "of one publisher no more");
    (3..6).for_each(|number| _ = keep(number, 8));
    assert_eq!(locals.trim(), 8);
    let mut bytes: Vec<usize> = (0..6).map(|i| locals.get(&Some((WRITER, i))).unwrap().bytes() >> 20).collect();
    bytes.sort_unstable();
    assert_eq!(bytes, [8, 48, 48, 48, 48, 56]);
    assert_eq!(locals.trim(), 0);
}

#[test]
fn it_is_hopeless_while_no_counterpart_can_be_made() {
    let (now, mut locals) = (Instant::now(), Locals::new(Instant::now()));
    assert!(!locals.are_hopeless(), "nobody is to be there");
    locals.change(now, joined(0, OFFER));
    assert!(!locals.are_hopeless(), "it was not tried");
    locals.get(&Some((WRITER, 0))).unwrap().failed(now, "no type".into());
    assert!(locals.are_hopeless());
    locals.change(now, Change::Left { writer: WRITER, number: 0 });
    assert!(!locals.are_hopeless());
}

const WRITER: Name = Name::from_bytes([1; 32]);

const OFFER: Offer = Offer {
    reliable: true,
    transient_local: false,
    depth: 1,
    deadline_ns: 0,
    lifespan_ns: 0,
    liveliness_ns: 0,
    manual_liveliness: false,
};

fn joined(number: u32, offers: Offer) -> Change {
    let kind = Kind { dialect: Dialect::Ros2, name: "std_msgs/msg/String".into(), hash: vec![] };
    Change::Joined { writer: WRITER, number, kind, definition: None, node: std::sync::Arc::default(), offers }
}

fn message(body: bytes::Bytes) -> Message {
    Message {
        name: Name::from_bytes([0; 32]),
        writer: WRITER,
        session: [0; 16],
        sequence: 0,
        timestamp_ns: 0,
        encoding: Encoding::Cdr,
        in_reply_to: None,
        origin: bytes::Bytes::new(),
        latched: None,
        service: None,
        body,
    }
}
