//! Unit tests of `ros2::graph`.

use super::*;

#[test]
fn endpoints_become_topics_services_and_actions() {
    let graph = Graph::new(
        [
            seen(1, 1, true, "rt/chatter", "std_msgs::msg::dds_::String_"),
            seen(2, 2, false, "rt/chatter", "std_msgs::msg::dds_::String_"),
            seen(1, 3, false, "rq/addRequest", "pkg::srv::dds_::Add_Request_"),
            seen(1, 4, true, "rr/addReply", "pkg::srv::dds_::Add_Response_"),
            seen(2, 5, true, "rq/addRequest", "pkg::srv::dds_::Add_Request_"),
            seen(2, 6, false, "rr/addReply", "pkg::srv::dds_::Add_Response_"),
            seen(1, 7, false, "rq/fib/_action/send_goalRequest", "pkg::action::dds_::Fib_SendGoal_Request_"),
            seen(1, 8, true, "rr/fib/_action/send_goalReply", "pkg::action::dds_::Fib_SendGoal_Response_"),
            seen(1, 9, true, "rt/fib/_action/feedback", "pkg::action::dds_::Fib_FeedbackMessage_"),
            seen(1, 10, true, "ros_discovery_info", "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"),
            seen(3, 11, false, "rq/halfRequest", "pkg::srv::dds_::Add_Request_"),
        ]
        .into_iter(),
        &NodeNames::of([(guid(1, 1).to_bytes(), "/robot/driver"), (guid(1, 3).to_bytes(), "/adder")]),
    );
    assert_eq!(graph.topics.len(), 1, "{graph:?}");
    let chatter = &graph.topics[&TopicName::parse("/chatter").unwrap()];
    assert_eq!((chatter.publishers.len(), chatter.subscribers.len()), (1, 1));
    assert_eq!(chatter.publishers[0].hash.as_ref().map(TypeHash::as_str), Some(HASH));
    assert_eq!((&*chatter.publishers[0].node, &*chatter.subscribers[0].node), ("/robot/driver", ""));
    assert_eq!(graph.services.len(), 1, "one half of a service is none");
    let add = &graph.services[&TopicName::parse("/add").unwrap()];
    assert_eq!(add.servers[0].kind, TypeName::parse("pkg/srv/Add").unwrap());
    assert_eq!((add.servers[0].id[0], add.clients[0].id[0]), (1, 2));
    assert_eq!(&*add.servers[0].node, "/adder");
    let fib = &graph.actions[&TopicName::parse("/fib").unwrap()];
    assert_eq!(fib.kind, TypeName::parse("pkg/action/Fib").unwrap());
    assert_eq!((fib.servers.len(), fib.clients.len()), (1, 0));
}

#[test]
fn only_a_well_formed_hash_is_believed() {
    let of = |text: &str| TypeHash::from_user_data(&[&[0; 4], text.as_bytes()].concat());
    assert_eq!(of(&format!("a=b;typehash={HASH};")).map(|hash| hash.0), Some(HASH.to_owned()));
    for bad in ["", "typehash=", "typehash=RIHS01_00;", "typehash=RIHS02_00", &HASH.replace('0', "G")] {
        assert_eq!(of(bad), None, "{bad}");
    }
    assert_eq!(TypeHash::from_user_data(&[1, 2]), None);
}

#[test]
fn the_hash_that_an_endpoint_announces_is_read_by_others() {
    let announced = user_data(&[0; 32]);
    let as_received = [&(announced.len() as u32).to_le_bytes(), &announced[..]].concat();
    assert_eq!(TypeHash::from_user_data(&as_received).map(|hash| hash.0), Some(HASH.to_owned()));
    assert!(user_data(&[]).is_empty());
}

#[test]
fn durations_without_end_are_none() {
    assert_eq!(finite(rustdds::Duration::INFINITE), None);
    assert_eq!(finite(rustdds::Duration::from_secs(-1)), None);
    assert_eq!(finite(rustdds::Duration::from_millis(1500)), Some(Duration::from_millis(1500)));
}

const HASH: &str = "RIHS01_0000000000000000000000000000000000000000000000000000000000000000";

fn guid(participant: u8, endpoint: u8) -> GUID {
    let mut guid = [participant; 16];
    guid[15] = endpoint;
    GUID::from_bytes(guid)
}

fn seen(participant: u8, endpoint: u8, writes: bool, topic: &str, kind: &str) -> Seen {
    Seen {
        guid: guid(participant, endpoint),
        writes,
        topic: topic.into(),
        kind: kind.into(),
        qos: QosPolicies::qos_none(),
        user_data: format!("\0\0\0\0typehash={HASH};").into_bytes(),
    }
}
