//! Who can be reached by whom under its own name, and who is told of whom.

use gdp_core::identity::Identity;
use gdp_proto::control::{NameRole, RefusalCode, Response};

use super::world::{Parts, World, expect_refused};
use crate::rib::Limits;

#[test]
fn counterparts_reach_each_other_and_nobody_else_does() {
    let mut w = World::chain(3);
    let (robot, cloud, other) = (w.attached("robot", 0), w.attached("cloud", 2), w.attached("other", 1));
    w.publish(&robot, 0, 1);
    assert_eq!(w.inbox_routes(&robot), [], "nobody reads");
    w.subscribe(&cloud, 2, 1);
    let bits = [0, 1, 2].map(|i| 1 << w.rib.bit(&w.switch(i)).unwrap());
    let [robot_name, cloud_name, other_name] = [&robot, &cloud, &other].map(Identity::name);
    assert_eq!(w.inbox_routes(&robot), [(0, 0, vec![robot_name], vec![]), (2, bits[0], vec![], vec![cloud_name])]);
    assert_eq!(w.inbox_routes(&cloud), [(0, bits[2], vec![], vec![robot_name]), (2, 0, vec![cloud_name], vec![])]);
    w.subscribe(&other, 1, 1);
    assert_eq!(w.inbox_routes(&other), [(0, bits[1], vec![], vec![robot_name]), (1, 0, vec![other_name], vec![])]);
    w.settle();
    w.check_delivery();

    // A second name that they share keeps them reachable when the first ends.
    let first = w.card.clone();
    w.another_name();
    w.publish(&cloud, 2, 2);
    w.subscribe(&robot, 0, 2);
    w.card = first;
    let withdrawal = Parts::withdraw(&w, &robot, 0, 3);
    w.ask(&robot, 0, withdrawal);
    assert_eq!(w.inbox_routes(&robot).len(), 2);
    assert_eq!(w.inbox_routes(&other), [], "this one has lost its writer");
    w.detach(&robot, 0);
    assert_eq!((w.inbox_routes(&robot), w.inbox_routes(&cloud)), (vec![], vec![]));
    w.settle();
    w.check_model();
}

#[test]
fn an_inbox_at_the_switch_of_its_sender_is_one_route() {
    let mut w = World::chain(1);
    let (robot, cloud) = (w.attached("robot", 0), w.attached("cloud", 0));
    w.publish(&robot, 0, 1);
    w.subscribe(&cloud, 0, 1);
    assert_eq!(w.inbox_routes(&robot), [(0, 1, vec![robot.name()], vec![cloud.name()])]);
    w.publish(&cloud, 0, 2);
    assert_eq!(w.inbox_routes(&cloud).len(), 1, "nobody reaches itself so");
}

#[test]
fn what_a_tool_stated_reaches_and_is_told_nobody() {
    let mut w = World::chain(1);
    let (cloud, robot) = (w.attached("cloud", 0), Identity::generate("proxy").unwrap());
    w.subscribe(&cloud, 0, 1);
    let request = Parts::publish(&w, &robot, 0).advertise();
    let response = w.rib.request(w.now, w.switch(0), Some(&robot.proof()), true, &request);
    let Response::Peers(peers) = response else { panic!("{response:?}") };
    assert_eq!(peers.records.len(), 1, "it is answered");
    assert_eq!(w.told(NameRole::Publisher), []);
    assert_eq!(w.told(NameRole::Subscriber), []);
    assert!(w.knows(&cloud, NameRole::Subscriber, &robot), "but its counterparts know it");
    assert_eq!(w.inbox_routes(&cloud), []);
}

#[test]
fn callers_send_to_servers_and_both_are_told() {
    let mut w = World::chain(2);
    let (server, caller) = (w.attached("server", 1), w.attached("caller", 0));
    w.state(&server, 1, 1, NameRole::Server);
    w.state(&caller, 0, 1, NameRole::Caller);
    assert_eq!(w.routes(), [], "to the service itself nothing is sent");
    let to_server = w.rib.desired(&w.switch(0)).into_iter().find(|route| route.name == server.name()).unwrap();
    let bit = 1 << w.rib.bit(&w.switch(1)).unwrap();
    assert_eq!((to_server.egress_bits, to_server.writers), (bit, vec![caller.name()]));
    assert_eq!(w.told(NameRole::Server), [(w.switch(1), server.name(), 1)]);
    assert!(w.knows(&caller, NameRole::Caller, &server), "from the answer");
    w.settle();
    w.check_model();
    w.check_delivery();
    w.detach(&server, 1);
    assert_eq!(w.told(NameRole::Caller), [(w.switch(0), caller.name(), 0)]);
    assert_eq!(w.inbox_routes(&server), []);
}

#[test]
fn who_may_only_read_a_name_does_not_send_to_its_readers_by_calling_it() {
    let mut w = World::chain(1);
    let (robot, cloud, other) = (w.attached("robot", 0), w.attached("cloud", 0), w.attached("other", 0));
    w.state(&other, 0, 1, NameRole::Caller);
    w.publish(&robot, 0, 1);
    w.subscribe(&cloud, 0, 1);
    let route = w.rib.desired(&w.switch(0)).into_iter().find(|route| route.name == w.card.name()).unwrap();
    assert_eq!((route.locals, route.writers), (vec![cloud.name()], vec![robot.name()]));
    assert_eq!(w.inbox_routes(&other), []);
    let refused = w.state(&other, 0, 2, NameRole::Server);
    expect_refused(&refused, "a published name", RefusalCode::Unsupported, "has a publisher already");
}

#[test]
fn the_name_of_an_entity_is_not_advertised_by_it() {
    let mut w = World::chain(1);
    let robot = w.attached("robot", 0);
    let mut parts = Parts::publish(&w, &robot, 0);
    (parts.owner, parts.proof) = (robot.key().clone(), robot.proof());
    (parts.cert.name, parts.advert.name) = (robot.name(), robot.name());
    expect_refused(&w.ask(&robot, 0, parts.advertise()), "its own", RefusalCode::Unsupported, "under its own name");
}

#[test]
fn a_topic_under_the_name_of_an_entity_takes_the_place_of_its_inbox() {
    let mut w = World::chain(2);
    let (robot, cloud, other) = (w.attached("robot", 0), w.attached("cloud", 1), w.attached("other", 1));
    w.publish(&robot, 0, 1);
    w.subscribe(&cloud, 1, 1);
    let inbox = w.inbox_routes(&robot);
    let mut parts = Parts::publish(&w, &other, 1);
    (parts.owner, parts.proof) = (robot.key().clone(), robot.proof());
    (parts.cert.name, parts.advert.name) = (robot.name(), robot.name());
    assert!(matches!(w.ask(&other, 1, parts.advertise()), Response::Peers(_)));
    assert_eq!(w.inbox_routes(&robot), [], "only its key can have allowed this");
    w.detach(&other, 1);
    assert_eq!(w.inbox_routes(&robot), inbox);
}

#[test]
fn counterparts_are_bounded() {
    let mut w = World::with(2, Limits { counterparts: 2, ..Limits::default() });
    let robot = w.attached("robot", 0);
    w.publish(&robot, 0, 1);
    let readers = [(); 3].map(|()| w.attached("reader", 1));
    w.subscribe(&readers[0], 1, 1);
    w.subscribe(&readers[1], 1, 1);
    expect_refused(
        &w.subscribe(&readers[2], 1, 1),
        "a third",
        RefusalCode::Limit,
        "exchanges messages with 2 entities",
    );
    w.detach(&readers[0], 1);
    assert!(matches!(w.subscribe(&readers[2], 1, 2), Response::Peers(_)));

    let mut w = World::with(2, Limits { counterparts_per_switch: 3, ..Limits::default() });
    let robot = w.attached("robot", 0);
    w.publish(&robot, 0, 1);
    for _ in 0..3 {
        let reader = w.attached("reader", 1);
        w.subscribe(&reader, 1, 1);
    }
    let reader = w.attached("reader", 1);
    expect_refused(&w.subscribe(&reader, 1, 1), "a fourth", RefusalCode::Limit, "have 3 counterparts");
}

#[test]
fn a_second_place_takes_room_at_its_switch_and_none_of_its_entity() {
    let mut w = World::with(4, Limits { counterparts_per_switch: 2, counterparts: 1, ..Limits::default() });
    let (first, robot, second) = (w.card.clone(), w.attached("robot", 0), w.attached("robot", 0));
    w.publish(&robot, 0, 1);
    let readers = [w.attached("reader", 1), w.attached("reader", 2)];
    w.subscribe(&readers[0], 1, 1);
    w.another_name();
    w.publish(&second, 0, 1);
    w.subscribe(&readers[1], 2, 1);
    w.attach_lane(&readers[1], 1, 1);
    let also = w.state_everywhere(&readers[1], 1, 2, NameRole::Subscriber);
    assert!(matches!(also, Response::Peers(_)), "it is the same counterpart: {also:?}");
    w.settle();
    w.check_model();

    // Now two pairs are at switch 1, as many as there may be; who is there stays.
    w.another_name();
    let (third, late) = (w.attached("robot", 3), w.attached("reader", 3));
    w.publish(&third, 3, 1);
    w.subscribe(&late, 3, 1);
    w.attach_lane(&late, 1, 1);
    let more = w.state_everywhere(&late, 1, 2, NameRole::Subscriber);
    expect_refused(&more, "a second place", RefusalCode::Limit, "have 2 counterparts");
    w.card = first;
    assert!(matches!(w.subscribe(&readers[0], 1, 2), Response::Peers(_)), "nothing is added");

    // Nor is a move an entity more.
    w.attach_lane(&readers[0], 1, 2);
    let moved = w.subscribe(&readers[0], 2, 3);
    assert!(matches!(moved, Response::Peers(_)), "{moved:?}");
    w.settle();
    w.check_model();
}

#[test]
fn an_entity_that_does_not_answer_holds_up_no_other() {
    let mut w = World::chain(2);
    let (deaf, robot, cloud) = (w.attached("deaf", 1), w.attached("robot", 0), w.attached("cloud", 1));
    for serial in 1..=8 {
        w.another_name();
        w.subscribe(&deaf, 1, serial);
        w.publish(&robot, 0, serial);
    }
    w.subscribe(&cloud, 1, 1);
    let late = w.attached("late", 0);
    w.publish(&late, 0, 1);
    let mut out = Vec::new();
    for effect in w.rib.effects(w.now) {
        if let crate::rib::Effect::Peers(push) = effect {
            out.push(push.entity);
        }
    }
    assert_eq!(out.iter().filter(|entity| **entity == deaf.name()).count(), 4, "of its nine messages");
    assert!(out.contains(&cloud.name()) && out.contains(&robot.name()));
}
