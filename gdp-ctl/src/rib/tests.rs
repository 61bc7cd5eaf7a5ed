//! The RIB as a whole: what it refuses and why, what a lost attachment takes with it, which routes follow.

use std::collections::BTreeMap;
use std::time::Duration;

use gdp::cert::{AdCert, Advert, AdvertOp, Mode, ReadGrant, RtCert, issue};
use gdp::control::{EntityRequest, Extent, FibPush, Record, RefusalCode, Response, Route};
use gdp::identity::{Identity, SigningKey};
use gdp::name::{Name, NamePrefix, NameProof};
use gdp::{NameCard, control};

use super::fib::Pushed;
use super::{Effect, HOLD, Limits, Now, Rib};

const UNIX: u64 = 1_800_000_000;
const HOUR: u32 = 3600;

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
        (
            "an expired certificate",
            Box::new(|p| p.cert.not_after = UNIX - 1),
            RefusalCode::Expired,
            "expired at Unix time",
        ),
        ("a certificate of tomorrow", Box::new(|p| p.cert.not_before = UNIX + 60), RefusalCode::NotYetValid, "not yet"),
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
    assert!(matches!(done, Response::Done), "{done:?}");
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
    expect_refused(&anonymous, "anonymous", RefusalCode::Malformed, "show the key");
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
        let response = w.ask(&robot, 0, EntityRequest::Attach { rt_cert: issue(key, claims).unwrap() });
        expect_refused(&response, what, code, "");
    }
    let response = w.ask(&robot, 0, EntityRequest::Attach { rt_cert: issue(robot.key(), &claims).unwrap() });
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
    let Response::Records { records, .. } = w.subscribe(&cloud, 2, 1) else { panic!() };
    assert_eq!(records.iter().map(|r| r.verify(UNIX).unwrap()).collect::<Vec<_>>(), [robot.name()]);
    let bit = 1 << w.rib.bit(&w.switch(2)).unwrap();
    assert_eq!(w.routes(), [(0, bit, None), (2, 0, Some(cloud.name()))]);

    w.publish(&late, 1, 1);
    assert_eq!(w.routes(), [(0, bit, None), (1, bit, None), (2, 0, Some(cloud.name()))]);
    let told = w.writers_told();
    assert_eq!(told, [(w.switch(2), cloud.name(), 2)], "the reader is told of its second writer");

    let parts = Parts::withdraw(&w, &robot, 0, 2);
    assert!(matches!(w.ask(&robot, 0, parts), Response::Done));
    assert_eq!(w.routes(), [(1, bit, None), (2, 0, Some(cloud.name()))]);
    w.detach(&late, 1);
    assert_eq!(w.routes(), []);
    assert_eq!(w.writers_told(), [(w.switch(2), cloud.name(), 0)]);
    w.detach(&cloud, 2);
    assert_eq!(w.rib.name_count(), 0);
}

#[test]
fn a_reader_is_told_of_its_writers_in_order() {
    let mut w = World::chain(2);
    let (cloud, robot, late) = (w.attached("cloud", 1), w.attached("robot", 0), w.attached("late", 0));
    w.subscribe(&cloud, 1, 1);
    w.publish(&robot, 0, 1);
    let told = |w: &mut World| {
        let effects = w.rib.effects(w.now).into_iter();
        effects
            .filter_map(|e| if let Effect::Writers(push) = e { Some(push.records.len()) } else { None })
            .collect::<Vec<_>>()
    };
    assert_eq!(told(&mut w), [1]);
    w.publish(&late, 0, 1);
    assert!(told(&mut w).is_empty(), "not before the first is answered");
    w.rib.told(&w.card.name());
    assert_eq!(told(&mut w), [2]);
}

#[test]
fn a_statement_is_settled_when_every_switch_concerned_holds_its_route() {
    let mut w = World::chain(3);
    let (robot, cloud) = (w.attached("robot", 0), w.attached("cloud", 2));
    w.settle();
    w.subscribe(&cloud, 2, 1);
    assert!(w.rib.is_settled(&w.card.name()), "nobody writes it, so no switch needs a route");
    w.publish(&robot, 0, 1);
    assert!(!w.rib.is_settled(&w.card.name()));
    for push in w.pushes() {
        assert!(!w.rib.is_settled(&w.card.name()));
        w.rib.pushed(w.now, &push.switch, push.generation, Pushed::Done);
    }
    assert!(w.rib.is_settled(&w.card.name()));
    w.publish(&robot, 0, 2);
    assert!(w.rib.is_settled(&w.card.name()), "a renewal changes no route");
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
    let refusal = w.rib.check_room(&name, &robot.name(), false).unwrap_err();
    assert_eq!((refusal.code, refusal.reason.as_str()), (RefusalCode::Limit, "the FIB is full"));
    assert_eq!(w.routes(), []);
    w.settle();
    w.publish(&robot, 0, 2);
    w.settle();
    w.rib.check_room(&name, &robot.name(), false).expect("there is room again");
    assert_eq!(w.routes().len(), 2);
}

#[test]
fn writer_and_reader_at_one_switch_share_a_route() {
    let mut w = World::chain(1);
    let (robot, cloud) = (w.attached("robot", 0), w.attached("cloud", 0));
    w.subscribe(&cloud, 0, 1);
    w.publish(&robot, 0, 1);
    assert_eq!(w.routes(), [(0, 1, Some(cloud.name()))]);
}

#[test]
fn a_second_subscriber_is_refused_until_the_first_is_gone() {
    let mut w = World::chain(2);
    let (a, b) = (w.attached("a", 0), w.attached("b", 1));
    w.subscribe(&a, 0, 1);
    expect_refused(&w.subscribe(&b, 1, 1), "second", RefusalCode::SecondSubscriber, &a.name().to_string());
    assert!(matches!(w.subscribe(&a, 0, 2), Response::Records { .. }), "the same one renews");
    w.detach(&a, 0);
    expect_refused(&w.subscribe(&b, 1, 1), "the refused statement again", RefusalCode::ReplayedSerial, "");
    assert!(matches!(w.subscribe(&b, 1, 2), Response::Records { .. }));
}

#[test]
fn a_grant_does_not_publish_and_a_certificate_does_not_read() {
    let mut w = World::chain(1);
    let robot = w.attached("robot", 0);
    let parts = Parts::publish(&w, &robot, 0);
    let grant = gdp::cert::Signed::from_bytes(issue(&w.owner, &parts.cert).unwrap().as_bytes().to_vec()).unwrap();
    let advert = issue(robot.key(), &Advert { op: AdvertOp::Subscribe, ..parts.advert.clone() }).unwrap();
    let response = w.ask(&robot, 0, EntityRequest::Subscribe { proof: parts.proof, grant, advert });
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
    assert!(matches!(w.publish(&robot, 1, 42), Response::Done));
    assert!(matches!(w.attach(&robot, 0), Response::Attached { serial: 42 }), "it moves");
    assert_eq!(w.rib.name_count(), 0, "and leaves what it had at the other switch");
    assert_eq!(w.detaches(), [(w.switch(1), robot.name())], "which is told, if it still has a link there");
    assert!(matches!(w.attach(&robot, 1), Response::Attached { .. }));
    assert!(matches!(w.attach(&robot, 0), Response::Attached { .. }));
    assert_eq!(w.detaches(), [(w.switch(1), robot.name())], "only where it is not");
    w.detach(&robot, 1);
    assert!(matches!(w.publish(&robot, 0, 43), Response::Done), "a late detach of the old place does no harm");
}

#[test]
fn a_tools_statement_lives_for_its_lifetime() {
    let mut w = World::chain(1);
    let robot = Identity::generate("proxy").unwrap();
    let mut parts = Parts::publish(&w, &robot, 0);
    parts.advert.lifetime = 60;
    let (origin, proof) = (w.switch(0), robot.proof());
    let response = w.rib.request(w.now, origin, Some(&proof), true, &parts.advertise());
    assert!(matches!(response, Response::Done), "{response:?}");
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
fn a_registration_ends_with_its_certificate() {
    let mut w = World::chain(1);
    let robot = w.attached("robot", 0);
    let mut parts = Parts::publish(&w, &robot, 0);
    parts.cert.not_after = UNIX + 10;
    assert!(matches!(w.ask(&robot, 0, parts.advertise()), Response::Done));
    w.pass(Duration::from_secs(10));
    assert_eq!(w.rib.name_count(), 0);
}

#[test]
fn a_spent_serial_is_known_as_long_as_its_certificate_is_valid() {
    let mut w = World::chain(1);
    let robot = w.attached("robot", 0);
    let mut parts = Parts::publish(&w, &robot, 0);
    parts.cert.not_after = UNIX + 100;
    assert!(matches!(w.ask(&robot, 0, parts.advertise()), Response::Done));
    w.detach(&robot, 0);
    w.pass(Duration::from_secs(100));
    w.attach(&robot, 0);
    expect_refused(&w.ask(&robot, 0, parts.advertise()), "replay", RefusalCode::ReplayedSerial, "");
    w.detach(&robot, 0);
    w.pass(Duration::from_secs(2));
    w.attach(&robot, 0);
    expect_refused(&w.ask(&robot, 0, parts.advertise()), "after the end", RefusalCode::Expired, "");
}

#[test]
fn limits_are_refused_by_name() {
    let limits = Limits { entities: 2, names: 3, names_per_entity: 2, attached_per_switch: 2 };
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
    expect_refused(&w.attach(&c, 0), "entities", RefusalCode::Limit, "2 entities are known");
}

#[test]
fn a_refused_move_leaves_the_attachment_where_it_was() {
    let mut w = World::with(2, Limits { attached_per_switch: 1, ..Limits::default() });
    let (_here, there) = (w.attached("here", 0), w.attached("there", 1));
    expect_refused(&w.attach(&there, 0), "a full switch", RefusalCode::Limit, "1 attached entities");
    assert!(matches!(w.publish(&there, 1, 1), Response::Done));
}

#[test]
fn writers_of_a_name_are_bounded_by_what_a_message_holds() {
    let mut w = World::chain(1);
    let reader = w.attached("reader", 0);
    w.subscribe(&reader, 0, 1);
    let refused = (0..200).find_map(|_| {
        let writer = w.attached("writer", 0);
        match w.publish(&writer, 0, 1) {
            Response::Refused(refusal) => Some(refusal),
            _ => None,
        }
    });
    assert!(refused.unwrap().reason.contains("writers"), "no bound");
    for effect in w.rib.effects(w.now) {
        if let Effect::Writers(push) = effect {
            assert!(push.records.len() > 20);
            control::encode(&control::Request::Writers(push)).expect("fits a message");
        }
    }
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
        assert!(records.iter().all(|r| r.name == *name && r.verify(UNIX).is_ok()), "{records:?}");
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
    w.report(1, Some(&[stays.name(), new.name()]));
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
fn a_switch_nobody_reaches_is_forgotten_after_a_while() {
    let mut w = World::chain(3);
    let (robot, cloud) = (w.attached("robot", 0), w.attached("cloud", 2));
    w.publish(&robot, 0, 1);
    w.subscribe(&cloud, 2, 1);
    w.links.retain(|(a, b)| (*a, *b) != (1, 2));
    w.report(1, None);
    w.pass(HOLD - Duration::from_secs(1));
    assert_eq!(w.routes().len(), 2, "held");
    w.links.push((1, 2));
    w.report(1, None);
    w.pass(Duration::from_secs(60));
    assert_eq!(w.routes().len(), 2, "it came back");
    w.links.retain(|(a, b)| (*a, *b) != (1, 2));
    w.report(1, None);
    w.pass(HOLD);
    assert_eq!(w.routes(), []);
    assert_eq!(w.rib.bit(&w.switch(2)), None);
    assert!(matches!(w.subscribe(&cloud, 2, 2), Response::Refused(_)));
}

/// Random joins, leaves and link failures: whatever happened, FIBs that follow the pushes equal the desired ones, and
/// every writer's frames reach exactly the reader of the name.
#[test]
fn pushes_bring_every_switch_to_its_desired_state_and_frames_to_their_reader() {
    let mut random = Random(11);
    for _ in 0..3 {
        let mut w = World::chain(6);
        w.links.extend([(0, 3), (2, 5)]);
        (0..6).for_each(|i| w.report(i, None));
        let mut entities: Vec<(Identity, usize, u64)> = (0..8)
            .map(|_| {
                let at = random.below(6);
                (w.attached("entity", at), at, 0)
            })
            .collect();
        let mut cards = vec![w.card.clone()];
        cards.resize_with(4, || w.another_name());
        for _ in 0..60 {
            let index = random.below(8);
            let (entity, at, serial) = &mut entities[index];
            *serial += 1;
            w.card = cards[random.below(4)].clone();
            match random.below(8) {
                0..=2 => drop(w.publish(entity, *at, *serial)),
                3 | 4 => drop(w.subscribe(entity, *at, *serial)),
                5 => {
                    let request = Parts::withdraw(&w, entity, *at, *serial);
                    w.ask(entity, *at, request);
                }
                6 => {
                    *at = random.below(6);
                    w.attach(entity, *at);
                }
                _ => {
                    let toggled = [(0, 3), (2, 5)][random.below(2)];
                    match w.links.iter().position(|link| *link == toggled) {
                        Some(i) => drop(w.links.remove(i)),
                        None => w.links.push(toggled),
                    }
                    w.report(toggled.0, None);
                    w.report(toggled.1, None);
                }
            }
            if random.below(3) == 0 {
                w.settle();
                w.check_delivery();
            }
        }
        for (entity, at, _) in &entities {
            w.detach(entity, *at);
        }
        w.settle();
        assert!(w.held.values().all(|held| held.routes.is_empty()), "names are left over");
        assert_eq!(w.rib.name_count(), 0);
    }
}

// ---- the world around a RIB

struct World {
    rib: Rib,
    now: Now,
    owner: SigningKey,
    card: NameCard,
    switches: Vec<Identity>,
    links: Vec<(usize, usize)>,
    /// What each switch holds after the pushes it got.
    held: BTreeMap<Name, Held>,
}

#[derive(Default)]
struct Held {
    own_bit: u8,
    reach: Vec<(Name, u64)>,
    routes: BTreeMap<Name, Route>,
}

impl World {
    fn chain(length: usize) -> Self {
        Self::with(length, Limits::default())
    }

    fn with(length: usize, limits: Limits) -> Self {
        let switches: Vec<_> = (0..length).map(|_| Identity::generate("switch").unwrap()).collect();
        let owner = SigningKey::generate().unwrap();
        let card = NameCard::create(owner.verify_key(), "topic", "/chatter", "T", None).unwrap();
        let mut world = Self {
            rib: Rib::new(switches[0].name(), limits),
            now: Now { unix: UNIX, clock: Duration::from_secs(1000) },
            owner,
            card,
            switches,
            links: (1..length).map(|i| (i - 1, i)).collect(),
            held: BTreeMap::new(),
        };
        (0..length).for_each(|i| world.report(i, Some(&[])));
        world
    }

    fn switch(&self, index: usize) -> Name {
        self.switches[index].name()
    }

    fn report(&mut self, index: usize, attached: Option<&[Name]>) {
        let near = self.links.iter().filter_map(|(a, b)| match index {
            i if i == *a => Some((self.switch(*b), 1)),
            i if i == *b => Some((self.switch(*a), 1)),
            _ => None,
        });
        let near: Vec<_> = near.collect();
        let response = self.rib.report(self.now, &self.switches[index].proof(), &near, attached);
        assert!(matches!(response, Response::Done), "{response:?}");
    }

    fn ask(&mut self, entity: &Identity, at: usize, request: EntityRequest) -> Response {
        self.rib.request(self.now, self.switch(at), Some(&entity.proof()), false, &request)
    }

    fn attach(&mut self, entity: &Identity, at: usize) -> Response {
        let claims = RtCert { entity: entity.name(), switch: self.switch(at), not_after: UNIX + 1_000_000 };
        self.ask(entity, at, EntityRequest::Attach { rt_cert: issue(entity.key(), &claims).unwrap() })
    }

    fn attached(&mut self, _what: &str, at: usize) -> Identity {
        let entity = Identity::generate("proxy").unwrap();
        let response = self.attach(&entity, at);
        assert!(matches!(response, Response::Attached { serial: 0 }), "{response:?}");
        entity
    }

    fn detach(&mut self, entity: &Identity, at: usize) {
        self.rib.detach(self.now, &self.switch(at), &entity.name());
    }

    fn publish(&mut self, entity: &Identity, at: usize, serial: u64) -> Response {
        let mut parts = Parts::publish(self, entity, at);
        parts.advert.serial = serial;
        self.ask(entity, at, parts.advertise())
    }

    fn subscribe(&mut self, entity: &Identity, at: usize, serial: u64) -> Response {
        let parts = Parts::publish(self, entity, at);
        let grant =
            ReadGrant { name: parts.cert.name, entity: entity.name(), not_before: UNIX, not_after: UNIX + 1_000_000 };
        let advert = Advert { op: AdvertOp::Subscribe, serial, ..parts.advert };
        let (grant, advert) = (issue(&self.owner, &grant).unwrap(), issue(entity.key(), &advert).unwrap());
        self.ask(entity, at, EntityRequest::Subscribe { proof: parts.proof, grant, advert })
    }

    fn query(&mut self, prefix: &str) -> Response {
        // A person types at least one digit; the empty prefix asks for what begins with any.
        let prefixes = if prefix.is_empty() {
            "0123456789abcdef".chars().map(String::from).collect()
        } else {
            vec![prefix.to_owned()]
        };
        let mut last = Response::Done;
        for prefix in prefixes {
            let prefix: NamePrefix = prefix.parse().unwrap();
            last = self.rib.request(self.now, self.switch(0), None, false, &EntityRequest::Query { prefix });
            if matches!(&last, Response::Records { records, .. } if !records.is_empty()) {
                break;
            }
        }
        last
    }

    fn another_name(&mut self) -> NameCard {
        self.card = NameCard::create(self.owner.verify_key(), "topic", "/chatter", "T", None).unwrap();
        self.card.clone()
    }

    fn pass(&mut self, time: Duration) {
        self.now.clock += time;
        self.now.unix += time.as_secs();
        self.rib.tick(self.now);
    }

    /// All routes that should be: switch index, bits, local entity.
    fn routes(&self) -> Vec<(usize, u64, Option<Name>)> {
        let of = |(i, s): (usize, &Identity)| {
            self.rib.desired(&s.name()).into_iter().map(move |r| (i, r.egress_bits, r.local)).collect::<Vec<_>>()
        };
        self.switches.iter().enumerate().flat_map(of).collect()
    }

    fn detaches(&mut self) -> Vec<(Name, Name)> {
        let effects = self.rib.effects(self.now).into_iter();
        effects
            .filter_map(|e| if let Effect::Detach { switch, entity } = e { Some((switch, entity)) } else { None })
            .collect()
    }

    fn writers_told(&mut self) -> Vec<(Name, Name, usize)> {
        let effects = self.rib.effects(self.now);
        let told = effects.into_iter().filter_map(|e| match e {
            Effect::Writers(push) => Some(push),
            _ => None,
        });
        let told: Vec<_> = told.collect();
        told.iter().for_each(|push| self.rib.told(&push.name));
        told.into_iter().map(|push| (push.switch, push.entity, push.records.len())).collect()
    }

    fn pushes(&mut self) -> Vec<FibPush> {
        let effects = self.rib.effects(self.now).into_iter();
        effects.filter_map(|e| if let Effect::Fib(push) = e { Some(push) } else { None }).collect()
    }

    /// Carries pushes out until there are none; the FIBs of the switches are then what the RIB wants.
    fn settle(&mut self) {
        loop {
            let effects = self.rib.effects(self.now);
            if effects.is_empty() {
                break;
            }
            for effect in effects {
                let Effect::Fib(push) = effect else { continue };
                let held = self.held.entry(push.switch).or_default();
                if matches!(push.extent, Extent::Full { part: 0, .. }) {
                    held.routes.clear();
                }
                (held.own_bit, held.reach) = (push.own_bit, push.reach);
                held.routes.extend(push.set.iter().map(|r| (r.name, r.clone())));
                held.routes.retain(|name, _| !push.remove.contains(name));
                self.rib.pushed(self.now, &push.switch, push.generation, Pushed::Done);
            }
        }
        for switch in &self.switches {
            let name = switch.name();
            let held: Vec<_> = self.held[&name].routes.values().cloned().collect();
            let mut desired = self.rib.desired(&name);
            desired.sort_by_key(|r| r.name);
            assert_eq!(held, desired);
        }
    }

    /// Sends a frame of every registered writer through the switches' FIBs, as `gdp_wire::forward` would.
    fn check_delivery(&self) {
        let (records, _) = self.rib.records(self.now, None, usize::MAX);
        for writer in records.iter().filter(|r| r.is_writer()) {
            let reader = records.iter().find(|r| r.name == writer.name && !r.is_writer());
            let expected = reader.map(|r: &Record| (r.switch, r.entity.name().unwrap()));
            assert_eq!(self.deliver(writer.switch, writer.name), expected);
        }
    }

    fn deliver(&self, from: Name, name: Name) -> Option<(Name, Name)> {
        let bits = self.held[&from].routes.get(&name)?.egress_bits;
        let mut at = from;
        for _ in 0..=self.switches.len() {
            let held = &self.held[&at];
            if bits == 1 << held.own_bit {
                return Some((at, held.routes.get(&name)?.local?));
            }
            at = held.reach.iter().find(|(_, reach)| bits & reach != 0)?.0;
        }
        panic!("a loop");
    }
}

/// The parts of a request, to be spoilt one at a time.
#[derive(Clone)]
struct Parts {
    owner: SigningKey,
    signer: SigningKey,
    proof: NameProof,
    cert: AdCert,
    advert: Advert,
    flip_cert: bool,
    flip_advert: bool,
}

impl Parts {
    fn publish(w: &World, entity: &Identity, at: usize) -> Self {
        let name = w.card.name();
        Self {
            owner: w.owner.clone(),
            signer: entity.key().clone(),
            proof: w.card.proof(),
            cert: AdCert {
                name,
                entity: entity.name(),
                mode: Mode::Unicast,
                scope: vec![],
                not_before: UNIX - 1,
                not_after: UNIX + 1_000_000,
            },
            advert: Advert {
                op: AdvertOp::Publish,
                name,
                entity: entity.name(),
                switch: w.switch(at),
                serial: 1,
                lifetime: 24 * HOUR,
            },
            flip_cert: false,
            flip_advert: false,
        }
    }

    fn advertise(&self) -> EntityRequest {
        let (mut ad_cert, mut advert) =
            (issue(&self.owner, &self.cert).unwrap(), issue(&self.signer, &self.advert).unwrap());
        if self.flip_cert {
            ad_cert = flipped(&ad_cert);
        }
        if self.flip_advert {
            advert = flipped(&advert);
        }
        EntityRequest::Advertise { proof: self.proof, ad_cert, advert }
    }

    fn withdraw(w: &World, entity: &Identity, at: usize, serial: u64) -> EntityRequest {
        let advert = Advert { op: AdvertOp::Withdraw, serial, ..Self::publish(w, entity, at).advert };
        EntityRequest::Withdraw { advert: issue(entity.key(), &advert).unwrap() }
    }
}

/// The last byte belongs to the signature.
fn flipped<T>(signed: &gdp::cert::Signed<T>) -> gdp::cert::Signed<T> {
    let mut bytes = signed.as_bytes().to_vec();
    *bytes.last_mut().unwrap() ^= 1;
    gdp::cert::Signed::from_bytes(bytes).unwrap()
}

fn expect_refused(response: &Response, what: &str, code: RefusalCode, needle: &str) {
    let Response::Refused(refusal) = response else { panic!("{what}: not refused but {response:?}") };
    assert_eq!(refusal.code, code, "{what}: {refusal}");
    assert!(refusal.reason.contains(needle), "{what}: {refusal}");
}

struct Random(u64);

impl Random {
    fn below(&mut self, bound: usize) -> usize {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 33) as usize % bound
    }
}
