//! Unit tests of `graph::zenoh::view`.

use super::*;

const STRING: &str =
    "std_msgs::msg::dds_::String_/RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";

pub fn snapshot(tokens: &[String]) -> Snapshot {
    let entity = |text: &String| Entity { gid: gdp_ros_zenoh::token::gid(text), token: Token::parse(text).unwrap() };
    Snapshot { entities: tokens.iter().map(|text| Arc::new(entity(text))).collect() }
}

fn endpoint(session: &str, role: &str, rest: &str) -> String {
    format!("@ros2_lv/0/{session}/0/7/{role}/%/%robot/driver/{rest}")
}

#[test]
fn proxies_are_not_in_the_graph_whatever_node_they_show() {
    let topic = format!("%chatter/{STRING}/::,7:,:,:,,");
    let snapshot = snapshot(&[
        "@ros2_lv/0/aa/0/0/NN/%/%/gdp_proxy_12".into(),
        endpoint("aa", "MP", &topic),
        "@ros2_lv/0/bb/0/0/NN/%/%robot/driver".into(),
        endpoint("bb", "MP", &topic),
        endpoint("bb", "MS", &topic),
    ]);
    let name = TopicName::parse("/chatter").unwrap();
    let graph = graph(&snapshot);
    let topic = &graph.topics[&name];
    assert_eq!((topic.publishers.len(), topic.subscribers.len()), (1, 1));
    assert_eq!(&*topic.publishers[0].node, "/robot/driver");
    assert!(topic.publishers[0].hash.as_ref().unwrap().as_str().starts_with("RIHS01_df66"));
    let publishers = publishers(&snapshot, &name);
    let [(key, seen)] = &publishers[..] else { panic!("{publishers:?}") };
    assert_eq!(topic.publishers[0].id, key.to_be_bytes());
    assert_eq!((seen.session.as_str(), seen.offers.depth, seen.kind.hash.len()), ("bb", 7, 32));
}

#[test]
fn an_action_is_its_service_send_goal() {
    let hash = STRING.split_once('/').unwrap().1;
    let part = |role: &str, part: &str, kind: &str| {
        endpoint("bb", role, &format!("%fibonacci%_action%{part}/{kind}/{hash}/::,10:,:,:,,"))
    };
    let graph = graph(&snapshot(&[
        part("SS", "send_goal", "a::action::dds_::Fibonacci_SendGoal_"),
        part("SS", "cancel_goal", "action_msgs::srv::dds_::CancelGoal_"),
        part("MP", "feedback", "a::action::dds_::Fibonacci_FeedbackMessage_"),
        endpoint("bb", "SS", &format!("%add/a::srv::dds_::Add_/{hash}/::,10:,:,:,,")),
        endpoint("bb", "MP", &format!("%odd/not_of_ros/{hash}/::,10:,:,:,,")),
    ]));
    let (name, action) = graph.actions.first_key_value().unwrap();
    assert_eq!((name.as_str(), action.kind.as_str(), action.servers.len()), ("/fibonacci", "a/action/Fibonacci", 1));
    assert_eq!(graph.services.keys().map(TopicName::as_str).collect::<Vec<_>>(), ["/add"]);
    assert!(graph.topics.is_empty(), "{:?}", graph.topics);
}

#[test]
fn an_offer_is_the_same_in_both_terms() {
    for given in [
        Offer::DEFAULT,
        Offer { transient_local: true, depth: 0, ..Offer::DEFAULT },
        Offer { reliable: false, deadline_ns: 5, lifespan_ns: 6, liveliness_ns: 7, ..Offer::DEFAULT },
    ] {
        assert_eq!(offer(&qos(&given)), given);
    }
}
