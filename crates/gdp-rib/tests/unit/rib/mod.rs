//! The RIB as a whole: what it refuses and why, what a lost attachment takes with it, which routes
//! follow.

mod counterparts;
mod federation;
mod interdomain;
mod kept;
mod random;
mod revocations;
mod stored;
mod world;
mod wrapped_keys;

use std::time::Duration;

use gdp_core::cert::{Advert, AdvertOp, ReadGrant, RtCert, Signed, issue};
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::name::{Name, NamePrefix, NameProof};
use gdp_core::peer::MAX_LANES;
use gdp_proto::control;
use gdp_proto::control::{EntityRequest, Extent, FibPush, NameRole, PeersExtent, Record, RefusalCode, Response, Route};

use self::world::{Parts, UNIX, World, expect_refused};
use super::fib::Pushed;
use super::peer_updates::AT_ONCE;
use super::{Effect, Limits, RESTART_TIME, Rib, RibRun, UNREPORTED, UpdateId};

#[test]
fn every_bad_advertisement_is_refused_with_its_reason() {
    let mut w = World::chain(2);
    let writer = w.attached("robot", 0);
    let stranger = Identity::generate("proxy").unwrap();
    let mut good = Parts::publish(&w, &writer, 0);
    good.advert.serial = 2;
    type Change<'a> = Box<dyn Fn(&mut Parts) + 'a>;
    let rows: Vec<(&str, Change, RefusalCode, &str)> = vec![
        (
            "a certificate by another owner",
            Box::new(|p| p.owner = SigningKey::generate().unwrap()),
            RefusalCode::BadSignature,
            "wrong key",
        ),
        (
            "another owner key in the proof",
            Box::new(|p| p.proof.owner_key = SigningKey::generate().unwrap().public()),
            RefusalCode::BadSignature,
            "wrong key",
        ),
        ("an owner key off the curve", Box::new(|p| p.proof.owner_key = [0xff; 33]), RefusalCode::Malformed, "key"),
        ("a wrong digest", Box::new(|p| p.proof.digest[3] ^= 1), RefusalCode::WrongName, "the digest"),
        (
            "a certificate for another name",
            Box::new(|p| p.cert.name = Name::from_bytes([7; 32])),
            RefusalCode::WrongName,
            "wrong name",
        ),
        ("an expired certificate", Box::new(|p| p.cert.not_after = UNIX - 1), RefusalCode::Expired, "expired 20"),
        (
            "a certificate of tomorrow",
            Box::new(|p| p.cert.not_before = UNIX + 3600),
            RefusalCode::NotYetValid,
            "not yet",
        ),
        (
            "a certificate for another entity",
            Box::new(|p| p.cert.entity = stranger.name()),
            RefusalCode::WrongEntity,
            "wrong entity",
        ),
        (
            "a statement by another key",
            Box::new(|p| p.signer = stranger.key().clone()),
            RefusalCode::BadSignature,
            "wrong key",
        ),
        (
            "a statement about another name",
            Box::new(|p| p.advert.name = Name::from_bytes([7; 32])),
            RefusalCode::WrongName,
            "wrong name",
        ),
        (
            "a statement for another entity",
            Box::new(|p| p.advert.entity = stranger.name()),
            RefusalCode::WrongEntity,
            "wrong entity",
        ),
        (
            "a statement for another switch",
            Box::new(|p| p.advert.switch = Name::from_bytes([7; 32])),
            RefusalCode::WrongSwitch,
            "wrong switch",
        ),
        (
            "a statement of another kind",
            Box::new(|p| p.advert.op = AdvertOp::Subscribe),
            RefusalCode::Malformed,
            "wrong operation",
        ),
        ("serial zero", Box::new(|p| p.advert.serial = 0), RefusalCode::ReplayedSerial, "replayed serial: 0"),
        (
            "no lifetime",
            Box::new(|p| (p.advert.lifetime, p.advert.serial) = (0, 1)),
            RefusalCode::Malformed,
            "lifetime",
        ),
        (
            "a flipped bit in the certificate",
            Box::new(|p| p.flip_cert = true),
            RefusalCode::BadSignature,
            "bad signature",
        ),
        (
            "a flipped bit in the statement",
            Box::new(|p| p.flip_advert = true),
            RefusalCode::BadSignature,
            "bad signature",
        ),
    ];
    for (what, change, code, needle) in rows {
        let mut parts = good.clone();
        change(&mut parts);
        let response = w.ask(&writer, 0, parts.advertise());
        expect_refused(&response, what, code, needle);
        assert_eq!(w.rib.name_count(), 0, "{what} was stored");
    }
    let [done, again] = [(); 2].map(|()| w.ask(&writer, 0, good.advertise()));
    assert!(matches!(done, Response::Peers(_)), "{done:?}");
    expect_refused(&again, "the same again", RefusalCode::ReplayedSerial, "replayed serial: 2 is not above 2");
}

#[test]
fn who_is_not_attached_here_is_refused() {
    let mut w = World::chain(2);
    let writer = w.attached("robot", 0);
    let request = Parts::publish(&w, &writer, 1).advertise();
    expect_refused(&w.ask(&writer, 1, request.clone()), "at another switch", RefusalCode::NotAttached, "attach first");
    let stranger = Identity::generate("proxy").unwrap();
    expect_refused(&w.ask(&stranger, 0, request.clone()), "unknown", RefusalCode::NotAttached, "attach first");
    let anonymous = w.rib.request(w.now, w.switch(0), None, false, &request);
    expect_refused(&anonymous, "anonymous", RefusalCode::Malformed, "show the entity's key");
    let nowhere = Name::from_bytes([9; 32]);
    let response = w.rib.request(w.now, nowhere, Some(&writer.proof()), false, &request);
    expect_refused(&response, "a switch that never reported", RefusalCode::Unreachable, "has not reported");
    let asked = w
        .rib
        .effects(w.now)
        .into_iter()
        .any(|e| matches!(e, Effect::Detach { switch, entity } if switch == nowhere && entity == nowhere));
    assert!(asked, "the unknown switch is told to report");
}

#[test]
fn an_attachment_needs_the_entitys_own_certificate_for_this_switch() {
    let mut w = World::chain(2);
    let (robot, other) = (Identity::generate("proxy").unwrap(), Identity::generate("proxy").unwrap());
    let claims = RtCert { entity: robot.name(), switch: w.switch(0), not_after: UNIX + 60 };
    let by_other = RtCert { entity: other.name(), ..claims.clone() };
    let elsewhere = RtCert { switch: w.switch(1), ..claims.clone() };
    let old = RtCert { not_after: UNIX - 1, ..claims.clone() };
    for (what, key, claims, code) in [
        ("signed by another", other.key(), &claims, RefusalCode::BadSignature),
        ("for another entity", robot.key(), &by_other, RefusalCode::WrongEntity),
        ("for another switch", robot.key(), &elsewhere, RefusalCode::WrongSwitch),
        ("expired", robot.key(), &old, RefusalCode::Expired),
    ] {
        let response =
            w.ask(&robot, 0, EntityRequest::Attach { rt_cert: issue(key, claims).unwrap(), resumes: true, lane: 0 });
        expect_refused(&response, what, code, "");
    }
    let response = w.ask(
        &robot,
        0,
        EntityRequest::Attach { rt_cert: issue(robot.key(), &claims).unwrap(), resumes: true, lane: 0 },
    );
    assert!(matches!(response, Response::Attached { serial: 0 }), "{response:?}");
    w.publish(&robot, 0, 1);
    w.pass(Duration::from_secs(61));
    assert_eq!(w.rib.name_count(), 0, "the attachment ends with its certificate");
    assert!(w.rib.effects(w.now).iter().any(|e| matches!(e, Effect::Detach { entity, .. } if *entity == robot.name())));
}

#[test]
fn a_name_is_routed_from_its_writers_to_its_reader_and_only_then() {
    let mut w = World::chain(3);
    let (robot, cloud, late) = (w.attached("robot", 0), w.attached("cloud", 2), w.attached("late", 1));
    w.publish(&robot, 0, 1);
    assert_eq!(w.routes(), [], "nobody reads");
    assert_eq!(w.rib.without_publisher().0, 0);
    let Response::Peers(peers) = w.subscribe(&cloud, 2, 1) else { panic!() };
    assert_eq!(peers.records.iter().map(|r| r.verify(None, UNIX).unwrap().entity).collect::<Vec<_>>(), [robot.name()]);
    let bit = 1 << w.rib.bit(&w.switch(2)).unwrap();
    assert_eq!(w.routes(), [(0, bit, vec![]), (2, 0, vec![cloud.name()])]);

    w.publish(&late, 1, 1);
    assert_eq!(w.routes(), [(0, bit, vec![]), (1, bit, vec![]), (2, 0, vec![cloud.name()])]);
    let told = w.told(NameRole::Subscriber);
    assert_eq!(told, [(w.switch(2), cloud.name(), 2)], "the reader is told of its second writer");

    let parts = Parts::withdraw(&w, &robot, 0, 2);
    assert!(matches!(w.ask(&robot, 0, parts), Response::Done));
    assert_eq!(w.routes(), [(1, bit, vec![]), (2, 0, vec![cloud.name()])]);
    assert_eq!(w.rib.without_publisher().0, 0);
    w.detach(&late, 1);
    assert_eq!(w.routes(), []);
    assert_eq!(w.rib.without_publisher().0, 1);
    assert_eq!(w.told(NameRole::Subscriber), [(w.switch(2), cloud.name(), 0)]);
    w.detach(&cloud, 2);
    assert_eq!((w.rib.name_count(), w.rib.without_publisher().0), (0, 0));
}

#[test]
fn a_reader_is_told_of_its_writers_in_order() {
    let mut w = World::chain(2);
    let (cloud, robot, late) = (w.attached("cloud", 1), w.attached("robot", 0), w.attached("late", 0));
    w.subscribe(&cloud, 1, 1);
    w.publish(&robot, 0, 1);
    let pushed = |w: &mut World| {
        let effects = w.rib.effects(w.now).into_iter();
        effects.filter_map(|e| if let Effect::Peers(push) = e { Some(push) } else { None }).collect::<Vec<_>>()
    };
    let pushes = pushed(&mut w);
    let [first] = &pushes[..] else { panic!("{pushes:?}") };
    assert_eq!((first.entity, first.role, first.peers.records.len()), (cloud.name(), NameRole::Subscriber, 1));
    w.publish(&late, 0, 1);
    w.detach(&robot, 0);
    assert!(pushed(&mut w).is_empty(), "not before the first is answered");
    w.rib.update_answered(w.now, UpdateId::from(first), true);
    let pushes = pushed(&mut w);
    let [second] = &pushes[..] else { panic!("{pushes:?}") };
    assert_eq!(second.peers.extent, PeersExtent::After(first.peers.generation));
    assert_eq!((second.peers.records.len(), &second.peers.departed[..]), (1, &[robot.name()][..]));

    w.rib.update_answered(w.now, UpdateId::from(second), false);
    assert!(pushed(&mut w).is_empty(), "not at once after a failure");
    assert_eq!(w.rib.next_tick(), Some(w.now.clock + Duration::from_millis(500)));
    w.pass(Duration::from_millis(500));
    let pushes = pushed(&mut w);
    let [whole] = &pushes[..] else { panic!("{pushes:?}") };
    assert_eq!(whole.peers.extent, PeersExtent::Whole { part: 0, last: true }, "nobody knows what arrived");
    assert_eq!(whole.peers.records.len(), 1);
    w.rib.update_answered(w.now, UpdateId::from(second), true);
    w.rib.update_answered(w.now, UpdateId::from(whole), false);
    w.report(1, &[cloud.name()]);
    assert_eq!(pushed(&mut w).len(), 1, "its switch is there again");
}

#[test]
fn a_statement_is_settled_when_every_switch_concerned_holds_its_route() {
    let mut w = World::chain(3);
    let (robot, cloud) = (w.attached("robot", 0), w.attached("cloud", 2));
    w.settle();
    w.subscribe(&cloud, 2, 1);
    assert!(w.is_settled(&cloud, NameRole::Subscriber), "nobody writes it, so no switch needs a route");
    w.publish(&robot, 0, 1);
    assert!(!w.is_settled(&robot, NameRole::Publisher));
    for push in w.pushes() {
        assert!(!w.is_settled(&robot, NameRole::Publisher));
        w.rib.pushed(w.now, &push.switch, push.generation, Pushed::Done);
    }
    assert!(w.is_settled(&robot, NameRole::Publisher));
    w.publish(&robot, 0, 2);
    assert!(w.is_settled(&robot, NameRole::Publisher), "a renewal changes no route");
}

#[test]
fn a_statement_that_a_switch_has_no_room_for_is_taken_back() {
    let mut w = World::chain(2);
    let (robot, cloud) = (w.attached("robot", 0), w.attached("cloud", 1));
    w.settle();
    w.subscribe(&cloud, 1, 1);
    w.publish(&robot, 0, 1);
    for push in w.pushes() {
        let full = push.switch == w.switch(1);
        let outcome = if full { Pushed::Partly("the FIB is full".into()) } else { Pushed::Done };
        w.rib.pushed(w.now, &push.switch, push.generation, outcome);
    }
    let name = w.card.name();
    let refusal = w.rib.check_room(&name, &robot.name(), NameRole::Publisher, &w.switch(0)).unwrap_err();
    assert_eq!((refusal.code, refusal.reason.as_str()), (RefusalCode::Limit, "the FIB is full"));
    assert_eq!(w.routes(), []);
    w.settle();
    w.publish(&robot, 0, 2);
    w.settle();
    w.rib.check_room(&name, &robot.name(), NameRole::Publisher, &w.switch(0)).expect("there is room again");
    assert_eq!(w.routes().len(), 2);

    // What it has stated where there is room stays.
    w.state_everywhere(&robot, 0, 3, NameRole::Publisher);
    w.settle();
    w.attach_lane(&robot, 1, 1);
    w.state_everywhere(&robot, 1, 4, NameRole::Publisher);
    for push in w.pushes() {
        w.rib.pushed(w.now, &push.switch, push.generation, Pushed::Partly("the FIB is full".into()));
    }
    w.rib.check_room(&name, &robot.name(), NameRole::Publisher, &w.switch(1)).unwrap_err();
    let places = w.rib.names.switches_of(name.as_bytes(), &robot.name(), NameRole::Publisher);
    assert_eq!(places, [w.switch(0)]);
}

#[test]
fn writer_and_reader_at_one_switch_share_a_route() {
    let mut w = World::chain(1);
    let (robot, cloud) = (w.attached("robot", 0), w.attached("cloud", 0));
    w.subscribe(&cloud, 0, 1);
    w.publish(&robot, 0, 1);
    assert_eq!(w.routes(), [(0, 1, vec![cloud.name()])]);
}

#[test]
fn every_subscriber_gets_a_copy_and_each_comes_and_goes_alone() {
    let mut w = World::chain(3);
    let (robot, late) = (w.attached("robot", 0), w.attached("late", 1));
    let mut readers: Vec<_> = [0, 2, 2].iter().map(|at| w.attached("reader", *at)).collect();
    readers[1..].sort_by_key(Identity::name);
    let [here, a, b] = [0, 1, 2].map(|i| readers[i].name());
    let bit = |w: &World, i| 1u64 << w.rib.bit(&w.switch(i)).unwrap();
    w.publish(&robot, 0, 1);
    w.settle();
    w.subscribe(&readers[1], 2, 1);
    assert_eq!(w.routes(), [(0, bit(&w, 2), vec![]), (2, 0, vec![a])]);
    w.settle();
    w.subscribe(&readers[2], 2, 1);
    let pushes = w.pushes();
    let name = w.card.name();
    let about_name = pushes.iter().filter(|push| push.set.iter().any(|route| route.name == name));
    assert_eq!(about_name.map(|p| p.switch).collect::<Vec<_>>(), [w.switch(2)], "nothing changes for the writer's");
    w.carry_out(pushes);
    w.subscribe(&readers[0], 0, 1);
    let both = bit(&w, 0) | bit(&w, 2);
    assert_eq!(w.routes(), [(0, both, vec![here]), (2, 0, vec![a, b])]);
    w.publish(&late, 1, 1);
    let mut told = w.told(NameRole::Subscriber);
    told.sort();
    let mut expected = [(w.switch(0), here, 2), (w.switch(2), a, 2), (w.switch(2), b, 2)];
    expected.sort();
    assert_eq!(told, expected, "every reader is told of the new writer");
    assert_eq!(w.routes(), [(0, both, vec![here]), (1, both, vec![]), (2, 0, vec![a, b])]);
    w.settle();
    w.check_delivery();

    w.detach(&readers[1], 2);
    assert_eq!(w.routes()[2], (2, 0, vec![b]));
    w.detach(&readers[2], 2);
    assert_eq!(w.routes(), [(0, bit(&w, 0), vec![here]), (1, bit(&w, 0), vec![])]);
    w.settle();
    w.check_delivery();
    let withdrawal = Parts::withdraw(&w, &readers[0], 0, 2);
    w.ask(&readers[0], 0, withdrawal);
    assert_eq!(w.routes(), []);
    assert!(matches!(w.subscribe(&readers[0], 0, 3), Response::Peers(_)), "and it may come back");
    assert_eq!(w.routes().len(), 2);
}

#[test]
fn subscribers_of_a_name_at_a_switch_are_bounded() {
    let mut w = World::with(2, Limits { readers_per_switch: 2, ..Limits::default() });
    let readers = [0, 0, 0, 1].map(|at| w.attached("reader", at));
    w.subscribe(&readers[0], 0, 1);
    w.subscribe(&readers[1], 0, 1);
    let refused = w.subscribe(&readers[2], 0, 1);
    expect_refused(&refused, "one more", RefusalCode::Limit, "has 2 subscribers at switch");
    assert!(matches!(w.subscribe(&readers[3], 1, 1), Response::Peers(_)), "at another switch");
    assert!(matches!(w.subscribe(&readers[1], 0, 2), Response::Peers(_)), "the same one renews");
    w.detach(&readers[0], 0);
    assert!(matches!(w.subscribe(&readers[2], 0, 2), Response::Peers(_)));
}

#[test]
fn a_reader_that_writes_has_both_at_its_switch() {
    let mut w = World::chain(2);
    let (both, other) = (w.attached("both", 0), w.attached("other", 1));
    w.subscribe(&both, 0, 1);
    w.publish(&both, 0, 2);
    w.subscribe(&other, 1, 1);
    let routes = w.rib.desired(&w.switch(0));
    let route = routes.iter().find(|route| route.name == w.card.name()).unwrap();
    assert_eq!((&route.locals[..], &route.writers[..]), (&[both.name()][..], &[both.name()][..]));
    w.settle();
    w.check_delivery();
}

#[test]
fn readers_are_told_a_few_at_a_time() {
    let mut w = World::chain(1);
    let robot = w.attached("robot", 0);
    for _ in 0..AT_ONCE + 5 {
        let reader = w.attached("reader", 0);
        w.subscribe(&reader, 0, 1);
    }
    w.publish(&robot, 0, 1);
    let told: Vec<_> = [(); 3].iter().map(|()| w.told(NameRole::Subscriber).len()).collect();
    assert_eq!(told, [AT_ONCE, 5, 0]);
}

#[test]
fn names_are_listed_for_who_is_attached_or_runs_a_switch_only() {
    let mut w = World::chain(2);
    let robot = w.attached("robot", 0);
    w.publish(&robot, 0, 1);
    let (stranger, other) = (Identity::generate("proxy").unwrap(), w.switches[1].proof());
    let name = w.card.name();
    let mut ask = |at: usize, whose: Option<&NameProof>, prefix: &str| {
        let request = EntityRequest::Query { prefix: prefix.parse().unwrap(), after: None };
        w.rib.request(w.now, w.switches[at].name(), whose, whose.is_none(), &request)
    };
    let digits = &name.to_string()[..63];
    for whose in [Some(robot.proof()), Some(stranger.proof()), None] {
        let found = ask(0, whose.as_ref(), &name.to_string());
        assert!(matches!(found, Response::Records { records, .. } if records.len() == 1), "{whose:?}");
    }
    for (at, whose) in [(0, None), (0, Some(stranger.proof())), (1, Some(robot.proof())), (0, Some(other))] {
        expect_refused(&ask(at, whose.as_ref(), digits), "a list", RefusalCode::NotEntitled, "in full");
    }
    for (at, whose) in [(0, robot.proof()), (1, other)] {
        let found = ask(at, Some(&whose), digits);
        assert!(matches!(found, Response::Records { records, .. } if records.len() == 1));
    }

    // As for a daemon that is just starting.
    let switch = w.switches[0].clone();
    w.rib = Rib::new(switch.name(), RibRun { id: 2, settling: Duration::ZERO }, Limits::default());
    let list = EntityRequest::Query { prefix: digits.parse().unwrap(), after: None };
    let early = w.rib.request(w.now, switch.name(), Some(&switch.proof()), true, &list);
    expect_refused(&early, "before its report", RefusalCode::Unreachable, "try again");
    assert_eq!(w.detaches(), [(switch.name(), switch.name())], "it is asked to report");
}

#[test]
fn a_query_is_answered_page_by_page() {
    let mut w = World::chain(1);
    let robot = w.attached("robot", 0);
    w.publish(&robot, 0, 1);
    for _ in 0..150 {
        let reader = w.attached("reader", 0);
        w.subscribe(&reader, 0, 1);
    }
    let prefix: NamePrefix = w.card.name().into();
    let mut found: Vec<Record> = Vec::new();
    loop {
        let after = found.last().map(|record| record.key().unwrap());
        let request = EntityRequest::Query { prefix: prefix.clone(), after };
        let response = w.rib.request(w.now, w.switch(0), None, false, &request);
        control::encode(&response).expect("fits a message");
        let Response::Records { records, truncated } = response else { panic!() };
        assert_eq!(found.is_empty(), records.iter().any(Record::is_writer), "writers come first");
        found.extend(records);
        if !truncated {
            break;
        }
    }
    assert!(found.len() == 151 && found.is_sorted_by_key(|record| record.key().unwrap()));
    let (all, more) = w.rib.records(w.now, None, 151);
    assert_eq!((all.len(), more), (151, false));
    let (rest, more) = w.rib.records(w.now, Some(found[99].key().unwrap()), 50);
    assert!(more && rest.iter().zip(&found[100..]).all(|(a, b)| a.key().unwrap() == b.key().unwrap()));
}

#[test]
fn a_grant_does_not_publish_and_a_certificate_does_not_read() {
    let mut w = World::chain(1);
    let robot = w.attached("robot", 0);
    let parts = Parts::publish(&w, &robot, 0);
    let cert = issue(&w.owner, &parts.cert).unwrap();
    let grant = Signed::<ReadGrant>::from_bytes(cert.as_bytes().to_vec()).unwrap().into();
    let advert = issue(robot.key(), &Advert { op: AdvertOp::Subscribe, ..parts.advert.clone() }).unwrap();
    let response = w.ask(&robot, 0, EntityRequest::Subscribe { proof: parts.proof, grant, advert, everywhere: false });
    expect_refused(&response, "AdCert as ReadGrant", RefusalCode::Malformed, "expected ReadGrant");
}

#[test]
fn what_lives_with_an_attachment_dies_with_it_and_serials_survive() {
    let mut w = World::chain(2);
    let robot = w.attached("robot", 0);
    w.publish(&robot, 0, 41);
    w.detach(&robot, 1);
    assert_eq!(w.rib.name_count(), 1, "another switch cannot detach it");
    assert!(matches!(w.attach(&robot, 0), Response::Attached { serial: 41 }));
    assert_eq!(w.rib.name_count(), 1, "it renews its attachment");
    w.detach(&robot, 0);
    assert_eq!(w.rib.name_count(), 0);
    assert!(matches!(w.attach(&robot, 1), Response::Attached { serial: 41 }));
    expect_refused(&w.publish(&robot, 1, 41), "replay", RefusalCode::ReplayedSerial, "not above 41");
    assert!(matches!(w.publish(&robot, 1, 42), Response::Peers(_)));
    assert!(matches!(w.attach(&robot, 0), Response::Attached { serial: 42 }), "it moves");
    assert_eq!(w.rib.name_count(), 0, "and leaves what it had at the other switch");
    assert_eq!(w.detaches(), [(w.switch(1), robot.name())], "which is told, if it still has a link there");
    assert!(matches!(w.attach(&robot, 1), Response::Attached { .. }));
    assert!(matches!(w.attach(&robot, 0), Response::Attached { .. }));
    assert_eq!(w.detaches(), [(w.switch(1), robot.name())], "only where it is not");
    w.detach(&robot, 1);
    assert!(matches!(w.publish(&robot, 0, 43), Response::Peers(_)), "a late detach of the old place does no harm");
}

#[test]
fn an_entity_with_two_links_is_reached_by_each_and_loses_one_at_a_time() {
    let mut w = World::chain(3);
    let (robot, cloud) = (w.attached("robot", 0), w.attached("cloud", 2));
    assert!(matches!(w.attach_lane(&robot, 1, 1), Response::Attached { serial: 0 }));
    let check = |w: &mut World, expected: &[(usize, usize)]| {
        w.tell_all();
        w.settle();
        w.check_model();
        w.check_delivery();
        w.check_record_limit();
        let places = |count: fn(&Route) -> usize| {
            let routes = (0..3).flat_map(|i| w.rib.desired(&w.switch(i)).into_iter().map(move |route| (i, route)));
            let routes = routes.filter(|(_, route)| route.name == w.card.name());
            routes.map(|(i, route)| (i, count(&route))).filter(|(_, count)| *count > 0).collect::<Vec<_>>()
        };
        assert_eq!(places(|route| route.locals.len()), expected);
        assert!(places(|route| usize::from(route.everywhere != route.locals)).is_empty());
    };
    w.publish(&cloud, 2, 1);
    for (at, serial) in [(0, 1), (1, 2)] {
        assert!(matches!(w.state_everywhere(&robot, at, serial, NameRole::Subscriber), Response::Peers(_)));
    }
    check(&mut w, &[(0, 1), (1, 1)]);
    assert_eq!(w.counterparts(&cloud, NameRole::Publisher), 1, "it is one reader all the same");
    w.detach(&robot, 0);
    check(&mut w, &[(1, 1)]);
    assert_eq!(w.counterparts(&cloud, NameRole::Publisher), 1);
    assert!(matches!(w.attach(&robot, 0), Response::Attached { serial: 2 }));
    w.state_everywhere(&robot, 0, 3, NameRole::Subscriber);
    check(&mut w, &[(0, 1), (1, 1)]);

    // What it takes by one link moves.
    w.state(&robot, 1, 4, NameRole::Subscriber);
    w.settle();
    assert_eq!(
        w.routes().into_iter().filter(|(.., locals)| !locals.is_empty()).map(|(at, ..)| at).collect::<Vec<_>>(),
        [1]
    );
    let claims = RtCert { entity: robot.name(), switch: w.switch(2), not_after: UNIX + 1_000_000 };
    let rt_cert = issue(robot.key(), &claims).unwrap();
    let anew = EntityRequest::Attach { rt_cert: rt_cert.clone(), resumes: false, lane: 0 };
    assert!(matches!(w.ask(&robot, 2, anew), Response::Attached { serial: 4 }));
    assert_eq!(w.routes(), [], "a process that starts anew has no other links");
    let too_many = EntityRequest::Attach { rt_cert, resumes: true, lane: MAX_LANES as u8 };
    expect_refused(&w.ask(&robot, 2, too_many), "a link too many", RefusalCode::Limit, "has 4 links");
}

#[test]
fn what_does_not_arrive_through_one_link_is_told_through_the_other() {
    let mut w = World::chain(2);
    let (robot, cloud) = (w.attached("robot", 0), w.attached("cloud", 0));
    w.attach_lane(&robot, 1, 1);
    w.state_everywhere(&robot, 0, 1, NameRole::Subscriber);
    w.state_everywhere(&robot, 1, 2, NameRole::Subscriber);
    w.tell_all();
    w.publish(&cloud, 0, 1);
    let next = |w: &mut World| {
        w.rib.effects(w.now).into_iter().find_map(|effect| match effect {
            Effect::Peers(push) if push.entity == robot.name() => Some(push),
            _ => None,
        })
    };
    let lost = next(&mut w).unwrap();
    assert_eq!(lost.switch, w.switch(1), "where it was stated last");
    w.rib.update_answered(w.now, UpdateId::from(&lost), false);
    let again = next(&mut w).unwrap();
    assert_eq!((again.switch, again.peers.records.len()), (w.switch(0), 1));
    w.rib.update_answered(w.now, UpdateId::from(&again), false);
    assert!(next(&mut w).is_none(), "both ways were tried");
    let mut since = Duration::ZERO;
    for _ in 0..4 {
        let wait = w.rib.peer_updates.retry_at().unwrap() - w.now.clock;
        assert!(wait >= (since * 2).max(Duration::from_millis(500)), "{wait:?} after {since:?}");
        since = wait;
        w.pass(wait);
        let tried = std::iter::from_fn(|| {
            let push = next(&mut w)?;
            w.rib.update_answered(w.now, UpdateId::from(&push), false);
            Some(push.switch)
        });
        let tried: Vec<_> = tried.take(3).collect();
        assert_eq!(tried.len(), 2, "each way once: {tried:?}");
    }
}

#[test]
fn a_tools_statement_lives_for_its_lifetime() {
    let mut w = World::chain(1);
    let robot = Identity::generate("proxy").unwrap();
    let mut parts = Parts::publish(&w, &robot, 0);
    parts.advert.lifetime = 60;
    let (origin, proof) = (w.switch(0), robot.proof());
    let response = w.rib.request(w.now, origin, Some(&proof), true, &parts.advertise());
    assert!(matches!(response, Response::Peers(_)), "{response:?}");
    w.attach(&robot, 0);
    w.detach(&robot, 0);
    assert_eq!(w.rib.name_count(), 1, "not bound to an attachment");
    w.pass(Duration::from_secs(59));
    assert_eq!(w.rib.name_count(), 1);
    w.pass(Duration::from_secs(1));
    assert_eq!(w.rib.name_count(), 0);

    w.attach(&robot, 0);
    parts.advert.serial = 2;
    w.rib.request(w.now, origin, Some(&proof), true, &parts.advertise());
    w.detach(&robot, 0);
    assert_eq!(w.rib.name_count(), 1, "nor to one that was there when it was made");
}

#[test]
fn a_statement_through_another_switch_moves_the_route() {
    let mut w = World::chain(3);
    let (robot, cloud) = (w.attached("robot", 0), Identity::generate("proxy").unwrap());
    w.publish(&robot, 0, 1);
    for (at, serial) in [(1, 1), (2, 2)] {
        let (origin, request) = (w.switch(at), w.subscription(&cloud, at, serial));
        w.rib.request(w.now, origin, Some(&cloud.proof()), true, &request);
        w.settle();
        w.check_model();
        w.check_delivery();
    }
    assert_eq!(w.routes().iter().map(|(at, ..)| *at).collect::<Vec<_>>(), [0, 2]);
}

#[test]
fn a_registration_ends_with_its_certificate() {
    let mut w = World::chain(1);
    let robot = w.attached("robot", 0);
    let mut parts = Parts::publish(&w, &robot, 0);
    parts.cert.not_after = UNIX + 10;
    assert!(matches!(w.ask(&robot, 0, parts.advertise()), Response::Peers(_)));
    w.pass(Duration::from_secs(10));
    assert_eq!(w.rib.name_count(), 0);
}

#[test]
fn what_was_stated_stays_spent_when_its_entity_is_forgotten() {
    let mut w = World::chain(1);
    let (robot, other) = (w.attached("robot", 0), w.attached("other", 0));
    let mut parts = Parts::publish(&w, &robot, 0);
    parts.advert.serial = 7;
    assert!(matches!(w.ask(&robot, 0, parts.advertise()), Response::Peers(_)));
    w.detach(&robot, 0);
    assert!(matches!(w.attach(&robot, 0), Response::Attached { serial: 7 }));
    expect_refused(&w.ask(&robot, 0, parts.advertise()), "replay", RefusalCode::ReplayedSerial, "not above 7");
    w.publish(&other, 0, 5);
    w.detach(&other, 0);
    assert!(matches!(w.attach(&other, 0), Response::Attached { serial: 7 }), "one floor is remembered for all");
}

#[test]
fn nobody_spends_the_serials_of_all() {
    let mut w = World::chain(1);
    let (robot, other) = (w.attached("robot", 0), w.attached("other", 0));
    expect_refused(&w.publish(&robot, 0, u64::MAX), "a jump", RefusalCode::Malformed, "too far above 0");
    let furthest = (UNIX + 2 * 24 * 3600) * 1_000_000_000;
    expect_refused(&w.publish(&robot, 0, furthest + 1), "beyond", RefusalCode::Malformed, "count up");
    assert!(matches!(w.publish(&robot, 0, furthest), Response::Peers(_)));
    w.detach(&robot, 0);
    w.detach(&other, 0);
    assert!(matches!(w.attach(&other, 0), Response::Attached { serial } if serial == furthest));
    assert!(matches!(w.publish(&other, 0, furthest + 1), Response::Peers(_)), "there is always a next one");
}

#[test]
fn limits_are_refused_by_name() {
    let limits =
        Limits { unattached_per_switch: 1, names: 3, names_per_entity: 2, attached_per_switch: 2, ..Limits::default() };
    let mut w = World::with(1, limits);
    let (a, b) = (w.attached("a", 0), w.attached("b", 0));
    let c = Identity::generate("proxy").unwrap();
    expect_refused(&w.attach(&c, 0), "attached", RefusalCode::Limit, "2 attached entities");
    w.publish(&a, 0, 1);
    w.another_name();
    w.publish(&a, 0, 2);
    w.another_name();
    expect_refused(&w.publish(&a, 0, 3), "names of an entity", RefusalCode::Limit, "already has 2 names");
    w.publish(&b, 0, 1);
    w.another_name();
    expect_refused(&w.publish(&b, 0, 2), "names", RefusalCode::Limit, "3 names are known");
    w.detach(&a, 0);
    assert!(matches!(w.attach(&c, 0), Response::Attached { .. }), "who is gone takes no room");
    w.detach(&b, 0);
    let strangers = [(); 2].map(|()| Identity::generate("proxy").unwrap());
    let by_tool = |w: &mut World, entity: &Identity| {
        let mut parts = Parts::publish(w, entity, 0);
        // Above what those who are gone have spent.
        parts.advert.serial = 9;
        w.rib.request(w.now, w.switch(0), Some(&entity.proof()), true, &parts.advertise())
    };
    assert!(matches!(by_tool(&mut w, &strangers[0]), Response::Peers(_)));
    expect_refused(&by_tool(&mut w, &strangers[1]), "unattached", RefusalCode::Limit, "1 entities are known through");
    w.pass(Duration::from_secs(24 * 3600));
    let late = by_tool(&mut w, &strangers[1]);
    expect_refused(&late, "one floor for all", RefusalCode::ReplayedSerial, "not above 9");
    assert!(matches!(w.attach(&strangers[1], 0), Response::Attached { serial: 9 }), "what the first stated has ended");
}

#[test]
fn a_refused_move_leaves_the_attachment_where_it_was() {
    let mut w = World::with(2, Limits { attached_per_switch: 1, ..Limits::default() });
    let (_here, there) = (w.attached("here", 0), w.attached("there", 1));
    expect_refused(&w.attach(&there, 0), "a full switch", RefusalCode::Limit, "1 attached entities");
    assert!(matches!(w.publish(&there, 1, 1), Response::Peers(_)));
}

#[test]
fn a_writer_moves_and_has_a_second_place_also_at_the_limit() {
    let mut w = World::with(2, Limits { writers_per_name: 2, ..Limits::default() });
    let (robot, other, third) = (w.attached("robot", 0), w.attached("other", 0), w.attached("third", 0));
    w.publish(&robot, 0, 1);
    w.attach_lane(&robot, 1, 1);
    let moved = w.publish(&robot, 1, 2);
    assert!(matches!(moved, Response::Peers(_)), "{moved:?}");
    w.state_everywhere(&robot, 0, 3, NameRole::Publisher);
    let second = w.publish(&other, 0, 1);
    assert!(matches!(second, Response::Peers(_)), "the first is one writer: {second:?}");
    w.attach_lane(&other, 1, 1);
    let moved = w.publish(&other, 1, 2);
    assert!(matches!(moved, Response::Peers(_)), "{moved:?}");
    expect_refused(&w.publish(&third, 0, 1), "a third", RefusalCode::Limit, "has 2 publishers");
}

#[test]
fn many_counterparts_come_in_parts_that_fit_a_message() {
    let mut w = World::with(1, Limits { writers_per_name: 150, ..Limits::default() });
    let reader = w.attached("reader", 0);
    w.subscribe(&reader, 0, 1);
    for _ in 0..150 {
        let writer = w.attached("writer", 0);
        w.publish(&writer, 0, 1);
    }
    let writer = w.attached("writer", 0);
    expect_refused(&w.publish(&writer, 0, 1), "one more", RefusalCode::Limit, "has 150 publishers");
    assert_eq!(w.counterparts(&reader, NameRole::Subscriber), 0, "not told yet");
    let pushes = w.tell_all();
    assert!(pushes > 1);
    assert_eq!(w.counterparts(&reader, NameRole::Subscriber), 150);

    let late = w.attached("late", 0);
    let response = w.subscribe(&late, 0, 1);
    control::encode(&response).expect("fits a message");
    let first = w.counterparts(&late, NameRole::Subscriber);
    assert!((1..150).contains(&first), "the answer holds {first}");
    w.tell_all();
    assert_eq!(w.counterparts(&late, NameRole::Subscriber), 150);
    w.subscribe(&late, 0, 2);
    w.tell_all();
    assert_eq!(w.counterparts(&late, NameRole::Subscriber), 150, "stated again");
    let response = w.query("");
    control::encode(&response).expect("fits a message");
}

#[test]
fn a_query_finds_by_prefix_and_shows_what_it_takes_to_verify() {
    let mut w = World::chain(1);
    let (robot, cloud) = (w.attached("robot", 0), w.attached("cloud", 0));
    let names: Vec<Name> = (1..=40)
        .map(|serial| {
            w.another_name();
            w.publish(&robot, 0, serial);
            w.card.name()
        })
        .collect();
    w.subscribe(&cloud, 0, 1);
    for name in &names {
        let Response::Records { records, truncated: false } = w.query(&name.to_string()[..12]) else { panic!() };
        assert!(records.iter().all(|r| r.name == *name && r.verify(None, UNIX).is_ok()), "{records:?}");
        assert_eq!(records.len(), if *name == w.card.name() { 2 } else { 1 });
    }
    for digit in "0123456789abcdef".chars() {
        let Response::Records { records, truncated: false } = w.query(&digit.to_string()) else { panic!() };
        let expected = names.iter().filter(|n| n.to_string().starts_with(digit)).count();
        let found = records.iter().filter(|r| r.is_writer()).count();
        assert_eq!(found, expected, "{digit}");
    }
}

#[test]
fn a_reconnected_switch_is_reconciled_both_ways() {
    let mut w = World::chain(2);
    let (stays, goes) = (w.attached("stays", 1), w.attached("goes", 1));
    w.publish(&stays, 1, 1);
    w.another_name();
    w.publish(&goes, 1, 1);
    w.settle();
    let new = Identity::generate("proxy").unwrap();
    w.report(1, &[stays.name(), new.name()]);
    assert_eq!(w.rib.name_count(), 1, "what is not attached any more is gone");
    let effects = w.rib.effects(w.now);
    let detach = effects.iter().find_map(|e| match e {
        Effect::Detach { switch, entity } => Some((*switch, *entity)),
        _ => None,
    });
    assert_eq!(detach, Some((w.switch(1), new.name())));
    let full =
        |e: &&Effect| matches!(e, Effect::Fib(push) if push.switch == w.switch(1) && push.extent != Extent::Delta);
    assert_eq!(effects.iter().filter(full).count(), 1, "it is sent its whole FIB");
}

#[test]
fn a_process_that_starts_anew_does_not_keep_what_another_stated() {
    let mut w = World::chain(2);
    let robot = w.attached("robot", 0);
    w.publish(&robot, 0, 5);
    let claims = RtCert { entity: robot.name(), switch: w.switch(0), not_after: UNIX + 60 };
    let attach = |resumes| EntityRequest::Attach { rt_cert: issue(robot.key(), &claims).unwrap(), resumes, lane: 0 };
    assert!(matches!(w.ask(&robot, 0, attach(true)), Response::Attached { serial: 5 }));
    assert_eq!(w.rib.name_count(), 1);
    assert!(matches!(w.ask(&robot, 0, attach(false)), Response::Attached { serial: 5 }));
    assert_eq!(w.rib.name_count(), 0);
    assert!(w.detaches().is_empty(), "its link stays");
}

#[test]
fn a_rib_that_has_started_has_entities_attach_again_and_says_when_it_knows_all() {
    let settled = Duration::from_secs(1060);
    let mut w = World::started(2, Limits::default(), RibRun { id: 7, settling: settled });
    let robot = Identity::generate("proxy").unwrap();
    let pushes = w.pushes();
    assert!(pushes.len() == 2 && pushes.iter().all(|push| push.settling && push.run == 7));
    w.carry_out(pushes);
    w.report(1, &[robot.name()]);
    assert_eq!(w.detaches(), [(w.switch(1), robot.name())]);
    w.attach(&robot, 1);
    w.publish(&robot, 1, 1);
    w.report(1, &[robot.name()]);
    assert!(w.detaches().is_empty());
    assert_eq!(w.rib.name_count(), 1, "a restart of its switch takes nothing along");
    w.settle();
    assert_eq!(w.rib.next_tick(), Some(settled));
    w.pass(Duration::from_secs(60));
    let pushes = w.pushes();
    assert!(pushes.len() == 2 && pushes.iter().all(|push| !push.settling && push.extent != Extent::Delta));
}

#[test]
fn who_was_told_while_the_rib_settled_is_told_the_whole_once_it_knows_all() {
    let mut w = World::started(2, Limits::default(), RibRun { id: 7, settling: Duration::from_secs(1060) });
    let (robot, cloud) = (w.attached("robot", 0), w.attached("cloud", 1));
    w.publish(&robot, 0, 1);
    let Response::Peers(peers) = w.subscribe(&cloud, 1, 1) else { panic!("refused") };
    assert!(peers.settling);
    assert!(w.tell().iter().all(|push| push.peers.settling));
    w.tell_all();
    w.pass(Duration::from_secs(60));
    let told = w.tell();
    let whole = PeersExtent::Whole { part: 0, last: true };
    assert_eq!(told.len(), 2, "robot and cloud");
    assert!(told.iter().all(|push| !push.peers.settling && push.peers.extent == whole));
    assert_eq!(w.tell_all(), 0);
}

#[test]
fn a_switch_nobody_reaches_is_forgotten_after_a_while() {
    let mut w = World::chain(3);
    let (robot, cloud) = (w.attached("robot", 0), w.attached("cloud", 2));
    w.publish(&robot, 0, 1);
    w.subscribe(&cloud, 2, 1);
    w.links.retain(|(a, b)| (*a, *b) != (1, 2));
    w.rewire();
    w.pass(RESTART_TIME - Duration::from_secs(1));
    assert_eq!(w.routes().len(), 2, "held");
    w.links.push((1, 2));
    w.rewire();
    w.pass(Duration::from_secs(60));
    assert_eq!(w.routes().len(), 2, "it came back");
    w.links.retain(|(a, b)| (*a, *b) != (1, 2));
    w.rewire();
    w.pass(RESTART_TIME);
    assert_eq!(w.routes(), []);
    assert_eq!(w.rib.bit(&w.switch(2)), None);
    assert!(matches!(w.subscribe(&cloud, 2, 2), Response::Refused(_)));
}

#[test]
fn a_switch_that_is_reached_and_says_nothing_is_asked_to_report() {
    let mut w = World::chain(3);
    w.links.retain(|(a, b)| (*a, *b) != (1, 2));
    w.rewire();
    w.pass(RESTART_TIME);
    assert_eq!(w.rib.bit(&w.switch(2)), None);
    let detaches = w.detaches();
    assert!(!detaches.contains(&(w.switch(2), w.switch(2))));
    w.links.push((1, 2));
    w.rewire();
    for _ in 0..2 {
        w.pass(UNREPORTED);
        assert_eq!(w.detaches(), [(w.switch(2), w.switch(2))], "again and again");
    }
    w.report(2, &[]);
    w.pass(UNREPORTED);
    assert_eq!(w.detaches(), []);
}

#[test]
fn a_bit_that_somebody_unknown_had_before_is_given_up() {
    let mut w = World::chain(3);
    let (robot, cloud) = (w.attached("robot", 0), w.attached("cloud", 2));
    w.publish(&robot, 0, 1);
    w.subscribe(&cloud, 2, 1);
    w.settle();
    let (first, stranger) = (w.rib.bit(&w.switch(2)).unwrap(), Name::from_bytes([9; 32]));
    let mut paths = w.rib.paths.clone();
    paths.bits.insert(first, stranger);
    paths.costs.insert(stranger, 1);
    w.rib.set_paths(w.now, paths);
    let second = w.rib.bit(&w.switch(2)).unwrap();
    assert_ne!(first, second);
    let pushes = w.pushes();
    assert!(pushes.iter().any(|push| push.switch == w.switch(2) && push.own_bit == second));
    let sends = |push: &FibPush| push.set.iter().any(|route| route.egress_bits == 1 << second);
    assert!(pushes.iter().any(|push| push.switch == w.switch(0) && sends(push)), "whoever sends there is told");
    w.carry_out(pushes);
    w.rewire();
    w.settle();
    w.check_model();
    w.check_delivery();
}
