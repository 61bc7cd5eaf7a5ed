//! Key boxes: kept for readers that come later, given to those that are there, and to nobody else.

use std::time::Duration;

use gdp_core::cert::issue;
use gdp_core::identity::Identity;
use gdp_core::keys::KeyBox;
use gdp_proto::control::{EntityRequest, NameRole, RefusalCode, Response};

use super::world::{Parts, World, expect_refused};
use crate::rib::Limits;

#[test]
fn a_reader_gets_its_boxes_when_it_comes_and_when_they_come() {
    let mut w = World::chain(2);
    let (robot, cloud, late) = (w.attached("robot", 0), w.attached("cloud", 1), w.attached("late", 1));
    let name = w.card.name();
    w.publish(&robot, 0, 1);
    w.subscribe(&cloud, 1, 1);
    w.tell_all();
    let readers = [cloud.name(), late.name()];
    let request = w.key_boxes(&robot, name, 7, &readers);
    assert!(matches!(w.ask(&robot, 0, request.clone()), Response::Done));
    w.tell_all();
    assert!(w.given.contains(&(name, robot.name(), cloud.name(), 7)));
    assert_eq!(w.given.len(), 1, "the other does not read");
    w.subscribe(&late, 1, 1);
    assert!(w.given.contains(&(name, robot.name(), late.name(), 7)), "with the answer");
    w.tell_all();
    assert!(matches!(w.ask(&robot, 0, request), Response::Done));
    assert!(w.tell().is_empty(), "the same again is no news");
}

#[test]
fn two_epochs_are_kept_and_end_with_what_they_were_kept_beside() {
    let mut w = World::chain(1);
    let (robot, cloud) = (w.attached("robot", 0), w.attached("cloud", 0));
    let name = w.card.name();
    w.publish(&robot, 0, 1);
    for epoch in [5, 7, 9] {
        w.boxes(&robot, 0, name, epoch, &[cloud.name()]);
    }
    let refused = w.boxes(&robot, 0, name, 6, &[cloud.name()]);
    expect_refused(&refused, "an old epoch", RefusalCode::ReplayedSerial, "epoch 6");
    let given = |w: &World| w.given.iter().map(|(.., epoch)| *epoch).collect::<Vec<_>>();
    w.subscribe(&cloud, 0, 1);
    assert_eq!(given(&w), [7, 9]);
    w.publish(&robot, 0, 2);
    w.given.clear();
    w.subscribe(&cloud, 0, 2);
    assert_eq!(given(&w), [7, 9], "a renewal keeps them");
    w.detach(&robot, 0);
    w.attach(&robot, 0);
    w.publish(&robot, 0, 3);
    w.given.clear();
    w.subscribe(&cloud, 0, 3);
    assert!(given(&w).is_empty(), "they ended with the attachment");
}

#[test]
fn a_box_is_refused_of_another_writer_for_another_name_and_with_another_signature() {
    let mut w = World::chain(1);
    let (robot, cloud, other) = (w.attached("robot", 0), w.attached("cloud", 0), w.attached("other", 0));
    let name = w.card.name();
    let refused = w.boxes(&robot, 0, name, 1, &[cloud.name()]);
    expect_refused(&refused, "not advertised", RefusalCode::NotEntitled, "advertise first");
    w.subscribe(&robot, 0, 1);
    expect_refused(&w.boxes(&robot, 0, name, 1, &[cloud.name()]), "a reader", RefusalCode::NotEntitled, "");
    w.publish(&robot, 0, 2);
    let claims = KeyBox { name, writer: robot.name(), reader: cloud.name(), epoch: 1, sealed: vec![0; 113] };
    let boxes =
        |key: &Identity, claims: &KeyBox| EntityRequest::KeyBoxes { boxes: vec![issue(key.key(), claims).unwrap()] };
    let request = boxes(&robot, &KeyBox { writer: other.name(), ..claims.clone() });
    expect_refused(&w.ask(&robot, 0, request), "another's", RefusalCode::WrongEntity, "");
    let request = boxes(&other, &claims);
    expect_refused(&w.ask(&robot, 0, request), "by another key", RefusalCode::BadSignature, "wrong key");
    let request = boxes(&robot, &claims);
    assert!(matches!(w.ask(&robot, 0, request), Response::Done));
}

#[test]
fn what_a_server_and_its_caller_send_each_other_has_boxes_of_its_own() {
    let mut w = World::chain(2);
    let (server, caller, other) = (w.attached("server", 0), w.attached("caller", 1), w.attached("other", 1));
    w.state(&server, 0, 1, NameRole::Server);
    let to_caller = |w: &mut World, epoch| w.boxes(&server, 0, caller.name(), epoch, &[caller.name()]);
    expect_refused(&to_caller(&mut w, 1), "no caller yet", RefusalCode::NotEntitled, "");
    w.state(&caller, 1, 1, NameRole::Caller);
    assert!(matches!(to_caller(&mut w, 1), Response::Done));
    w.tell_all();
    let key = |epoch| (caller.name(), server.name(), caller.name(), epoch);
    assert!(w.given.contains(&key(1)));
    assert!(matches!(to_caller(&mut w, 2), Response::Done));
    w.tell_all();
    assert!(w.given.contains(&key(2)));
    expect_refused(
        &w.boxes(&server, 0, caller.name(), 1, &[other.name()]),
        "for somebody else's inbox",
        RefusalCode::NotEntitled,
        "",
    );
    assert!(matches!(w.boxes(&caller, 1, server.name(), 1, &[server.name()]), Response::Done));
    w.tell_all();
    assert!(w.given.contains(&(server.name(), caller.name(), server.name(), 1)), "and the other way round");
    let name = w.card.name();
    let refused = w.boxes(&caller, 1, name, 1, &[server.name()]);
    expect_refused(&refused, "nothing goes to the service itself", RefusalCode::NotEntitled, "publishes");
    let withdrawal = Parts::withdraw(&w, &caller, 1, 2);
    w.ask(&caller, 1, withdrawal);
    w.given.clear();
    w.state(&caller, 1, 3, NameRole::Caller);
    w.tell_all();
    assert!(w.given.is_empty(), "they ended with the pair");
}

#[test]
fn boxes_are_bounded() {
    let limits = Limits { box_readers: 3, boxes_per_entity: 5, boxes_per_switch: 6, ..Limits::default() };
    let mut w = World::with(1, limits);
    let (a, b) = (w.attached("a", 0), w.attached("b", 0));
    let name = w.card.name();
    w.publish(&a, 0, 1);
    w.publish(&b, 0, 1);
    let readers = [(); 4].map(|()| Identity::generate("proxy").unwrap().name());
    expect_refused(&w.boxes(&a, 0, name, 1, &readers), "readers", RefusalCode::Limit, "3 readers of an epoch");
    expect_refused(&w.boxes(&a, 0, name, 2, &readers[..3]), "entity", RefusalCode::Limit, "5 key boxes");
    assert!(matches!(w.boxes(&b, 0, name, 1, &readers[..1]), Response::Done));
    expect_refused(&w.boxes(&b, 0, name, 1, &readers[..2]), "switch", RefusalCode::Limit, "6 key boxes of all");
    assert!(matches!(w.boxes(&a, 0, name, 3, &readers[..3]), Response::Done), "instead of the first epoch's");
    w.detach(&a, 0);
    assert!(matches!(w.boxes(&b, 0, name, 1, &readers[..3]), Response::Done));
    w.pass(Duration::from_secs(24 * 3600));
    let refused = w.boxes(&b, 0, name, 1, &readers[..1]);
    expect_refused(&refused, "its statement ended", RefusalCode::NotEntitled, "");
}
