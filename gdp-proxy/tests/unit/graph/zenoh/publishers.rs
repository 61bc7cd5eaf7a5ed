//! Unit tests of `graph::zenoh::publishers`.

use bytes::Bytes;
use gdp_ros::roster::{Dialect, Kind, Offer};
use gdp_ros_zenoh::{Attachment, Endpoint, Qos};

use super::*;

fn publisher(session: &str) -> Seen {
    Seen {
        kind: Kind { dialect: Dialect::Ros2, name: "std_msgs/msg/String".into(), hash: vec![] },
        endpoint: Endpoint { name: "/a".into(), kind: "b".into(), hash: None, qos: Qos::default() },
        node: "/n".into(),
        session: session.into(),
        offers: Offer::DEFAULT,
    }
}

fn received(gid: u8, session: Option<&str>) -> Received {
    let attachment = Attachment { sequence: 1, time_ns: 0, gid: [gid; 16] };
    Received { attachment, bytes: Bytes::new(), session: session.map(str::to_owned) }
}

#[test]
fn a_message_is_of_the_publisher_that_it_names_or_else_of_the_only_one_of_its_session() {
    let mut publishers = Publishers::default();
    let own = Key::from_be_bytes([1; 16]);
    publishers.by_key.extend([(own, publisher("a")), (2, publisher("b")), (3, publisher("c")), (4, publisher("c"))]);
    assert_eq!(publishers.of(&received(1, None)), Some(own));
    assert_eq!(publishers.of(&received(9, Some("b"))), Some(2));
    assert_eq!(publishers.of(&received(9, None)), Some(2), "as before");
    assert_eq!(publishers.of(&received(8, Some("c"))), None, "there are two");
    assert_eq!(publishers.of(&received(8, None)), None);
    assert_eq!(publishers.only(), None);
    publishers.remove(&2);
    assert_eq!(publishers.of(&received(9, Some("b"))), None);
}

#[test]
fn lost_messages_are_the_gaps_in_the_numbers() {
    let mut publishers = Publishers::default();
    let numbers = [5, 6, 9, 9, 2, 3, i64::MAX, i64::MIN, 0];
    assert_eq!(numbers.map(|number| publishers.lost(1, number)), [0, 0, 2, 0, 0, 0, 0, 0, 0]);
    let key = Key::from_be_bytes([1; 16]);
    publishers.by_key.insert(key, publisher("a"));
    assert_eq!(publishers.lost(key, 7), 0);
    publishers.skip(&Attachment { sequence: 8, time_ns: 0, gid: [1; 16] });
    assert_eq!(publishers.lost(key, 9), 0, "the skipped one counts as unreadable");
}
