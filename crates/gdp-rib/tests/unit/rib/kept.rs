//! What is kept of a name: nothing of what entities hold already, and nothing of what is over.

use std::time::Duration;

use gdp_core::identity::Identity;
use gdp_proto::control::{NameRole, PeersExtent, Response};

use super::world::{Parts, World};

#[test]
fn of_who_has_been_told_all_no_stream_is_kept_and_changes_follow_all_the_same() {
    let mut w = World::chain(2);
    let (robot, cloud, late) = (w.attached("robot", 0), w.attached("cloud", 1), w.attached("late", 0));
    w.publish(&robot, 0, 1);
    assert_eq!(w.rib.peer_updates.streams(), 0, "it was answered with all there is");
    w.subscribe(&cloud, 1, 1);
    assert_eq!(w.rib.peer_updates.streams(), 1, "the writer has a reader now");
    let first = w.tell();
    assert_eq!(first.len(), 1);
    assert_eq!(w.rib.peer_updates.streams(), 0, "and has heard of it");
    w.publish(&late, 0, 1);
    w.detach(&robot, 0);
    let pushes = w.tell();
    let [to_reader] = &pushes[..] else { panic!("{pushes:?}") };
    assert!(matches!(to_reader.peers.extent, PeersExtent::After(_)), "not the whole: {to_reader:?}");
    assert_eq!((to_reader.peers.records.len(), &to_reader.peers.departed[..]), (1, &[robot.name()][..]));
    assert_eq!((w.tell_all(), w.rib.peer_updates.streams()), (0, 0));
    w.check_record_limit();
}

#[test]
fn an_entity_that_is_reached_by_two_ways_keeps_both() {
    let mut w = World::chain(2);
    let (robot, cloud) = (w.attached("robot", 0), w.attached("cloud", 0));
    w.publish(&robot, 0, 1);
    w.attach_lane(&cloud, 1, 1);
    w.state_everywhere(&cloud, 0, 1, NameRole::Subscriber);
    w.state_everywhere(&cloud, 1, 2, NameRole::Subscriber);
    w.tell_all();
    w.detach(&cloud, 1);
    let whole: Vec<_> = w.tell().into_iter().filter(|push| push.entity == cloud.name()).collect();
    let [push] = &whole[..] else { panic!("{whole:?}") };
    assert_eq!((push.switch, push.peers.extent), (w.switch(0), PeersExtent::Whole { part: 0, last: true }));
    assert_eq!((w.tell_all(), w.rib.peer_updates.streams()), (0, 0), "there is one way now");
    w.check_record_limit();
}

#[test]
fn each_part_in_a_name_ends_in_its_time() {
    let mut w = World::chain(1);
    let mut lives = |lifetime: u32| {
        let robot = w.attached("robot", 0);
        (publish(&mut w, &robot, 1, lifetime), robot)
    };
    let [(.., short), (.., renewed), (.., long)] = [10, 20, 30].map(&mut lives);
    let left = |w: &mut World, seconds: u64| {
        w.pass(Duration::from_secs(seconds));
        w.rib.records(w.now, None, 10).0.len()
    };
    assert_eq!(left(&mut w, 9), 3);
    publish(&mut w, &renewed, 2, 60);
    assert_eq!(left(&mut w, 1), 2, "{} is over", short.name());
    assert_eq!(left(&mut w, 10), 2, "one was stated again");
    assert_eq!(left(&mut w, 10), 1, "{} is over", long.name());
    assert_eq!(left(&mut w, 38), 1);
    assert_eq!(left(&mut w, 1), 0);
    assert_eq!(w.rib.name_count(), 0);
    let is_about_name = |timer: &&_| matches!(timer, (_, crate::rib::Timer::Name(_)));
    assert_eq!(w.rib.timers.iter().filter(is_about_name).count(), 0, "nothing is left of it");
}

fn publish(w: &mut World, robot: &Identity, serial: u64, lifetime: u32) {
    let mut parts = Parts::publish(w, robot, 0);
    (parts.advert.lifetime, parts.advert.serial) = (lifetime, serial);
    let response = w.ask(robot, 0, parts.advertise());
    assert!(matches!(response, Response::Peers(_)), "{response:?}");
}
