//! What an owner takes back: it holds no longer, nowhere, and all concerned know why.

use std::time::Duration;

use gdp_core::cert::{Delegation, Grantee, Issued, MemberCert, Membership, ReadGrant, Reading, Revocation, issue};
use gdp_core::identity::{Identity, SigningKey};
use gdp_proto::control::{EntityRequest, NameRole, RefusalCode, Response};

use super::world::{Parts, UNIX, World, expect_refused};
use crate::rib::{Limits, Rib, RibRun};

#[test]
fn what_is_revoked_is_dropped_at_once_and_all_are_told() {
    let mut w = World::chain(3);
    let (robot, stolen, cloud) = (w.attached("robot", 0), w.attached("stolen", 1), w.attached("cloud", 2));
    w.publish(&robot, 0, 1);
    w.serial += 7;
    let serial = w.serial;
    w.subscribe(&stolen, 1, 1);
    w.serial += 1;
    w.subscribe(&cloud, 2, 1);
    w.tell_all();
    assert_eq!(w.counterparts(&robot, NameRole::Publisher), 2);
    assert!(matches!(w.revoke(1, 0, &[serial]), Response::Done));
    assert!(w.routes().iter().all(|(at, ..)| *at != 1), "ungrafted");
    assert_eq!(w.inbox_routes(&stolen), [], "nor is it reached any more");
    w.tell_all();
    for (entity, role) in
        [(&robot, NameRole::Publisher), (&stolen, NameRole::Subscriber), (&cloud, NameRole::Subscriber)]
    {
        let node = &w.nodes[&(entity.name(), w.card.name(), role)];
        assert_eq!(node.revocation().map(|r| r.number), Some(1), "told");
    }
    assert!(!w.knows(&robot, NameRole::Publisher, &stolen) && w.knows(&robot, NameRole::Publisher, &cloud));
    w.serial = serial;
    let refused = w.subscribe(&stolen, 1, 2);
    expect_refused(&refused, "again", RefusalCode::Revoked, &format!("ReadGrant with serial {serial}"));
    expect_refused(&refused, "again", RefusalCode::Revoked, "floor 0");
    w.serial += 2;
    assert!(matches!(w.subscribe(&stolen, 1, 3), Response::Peers(_)), "under a new grant");
    w.settle();
    w.check_model();
    w.check_record_limit();
}

#[test]
fn what_a_domain_takes_back_of_a_member_ends_what_it_reads_as_one() {
    let mut w = World::chain(2);
    let (robot, stolen, cloud) = (w.attached("robot", 0), w.attached("stolen", 1), w.attached("cloud", 1));
    let domain = Identity::generate("domain").unwrap();
    w.publish(&robot, 0, 1);
    let subscribe = |w: &mut World, entity: &Identity, statement, serial| {
        let mut request = w.subscription(entity, 1, statement);
        let EntityRequest::Subscribe { grant, .. } = &mut request else { panic!("{request:?}") };
        let (role, not_before, not_after) = ("operator".to_owned(), UNIX, UNIX + 1000);
        let to = Grantee::Role { domain: domain.name(), role: role.clone() };
        let named = grant.grant.cert.claims_unverified().unwrap();
        let (of_domain, member) = (domain.name(), entity.name());
        let cert = MemberCert { domain: of_domain, entity: member, role, serial, not_before, not_after };
        let member = Some(Membership::issue(&domain, &cert).unwrap());
        *grant = Reading {
            grant: issue(&w.owner, &ReadGrant { to, ..named }).unwrap().into(),
            member: member.map(Box::new),
        };
        w.ask(entity, 1, request)
    };
    for (entity, serial) in [(&stolen, 7), (&cloud, 8)] {
        assert!(matches!(subscribe(&mut w, entity, 1, serial), Response::Peers(_)));
    }
    w.tell_all();
    assert_eq!(w.counterparts(&robot, NameRole::Publisher), 2);
    let claims = Revocation { name: domain.name(), number: 1, floor: 0, revoked: vec![7], signer: None };
    let now = w.now;
    w.rib.domain_revoked(now, &claims);
    w.tell_all();
    assert!(!w.knows(&robot, NameRole::Publisher, &stolen) && w.knows(&robot, NameRole::Publisher, &cloud));
    assert_eq!(w.inbox_routes(&stolen), [], "nor is it reached any more");
    let refused = subscribe(&mut w, &stolen, 2, 7);
    expect_refused(&refused, "again", RefusalCode::Revoked, "MemberCert with serial 7");
    assert!(matches!(subscribe(&mut w, &stolen, 3, 9), Response::Peers(_)), "it is a member anew");
    w.settle();
    w.check_model();
}

#[test]
fn a_floor_takes_back_what_was_issued_before_and_by_whom() {
    let mut w = World::chain(1);
    let (robot, other) = (w.attached("robot", 0), w.attached("other", 0));
    let delegate = SigningKey::generate().unwrap();
    let delegation = Delegation {
        name: w.card.name(),
        delegate: delegate.verify_key(),
        publish: true,
        read: false,
        serial: w.serial - 5,
        not_before: UNIX,
        not_after: UNIX + 1000,
    };
    let parts = Parts::publish(&w, &robot, 0);
    let cert = issue(&delegate, &parts.cert).unwrap();
    let ad_cert = Issued { cert, delegation: Some(issue(&w.owner, &delegation).unwrap()) };
    let advert = issue(robot.key(), &parts.advert).unwrap();
    let request = EntityRequest::Advertise { proof: parts.proof, ad_cert, advert, everywhere: false };
    assert!(matches!(w.ask(&robot, 0, request), Response::Peers(_)));
    w.publish(&other, 0, 1);
    let floor = w.serial - 4;
    assert!(matches!(w.revoke(1, floor, &[]), Response::Done));
    let (records, _) = w.rib.records(w.now, None, 10);
    assert_eq!(records.len(), 1, "the delegation fell, and with it what was issued under it");
    assert_eq!(records[0].entity, other.proof());
}

#[test]
fn an_older_revocation_brings_nothing_back() {
    let mut w = World::chain(1);
    let robot = w.attached("robot", 0);
    let after = w.serial + 1;
    assert!(matches!(w.revoke(5, after, &[]), Response::Done), "before anybody advertises the name");
    assert!(matches!(w.revoke(5, after, &[]), Response::Done), "the same again");
    for (number, floor) in [(4, 0), (5, 0)] {
        expect_refused(&w.revoke(number, floor, &[]), "older", RefusalCode::ReplayedSerial, "does not replace 5");
    }
    expect_refused(&w.publish(&robot, 0, 1), "below the floor", RefusalCode::Revoked, "revocation 5");
    w.owner = SigningKey::generate().unwrap();
    expect_refused(&w.revoke(6, 0, &[]), "by another", RefusalCode::BadSignature, "wrong key");
    let claims = Revocation { name: robot.name(), number: 6, floor: 0, revoked: vec![], signer: None };
    let request = EntityRequest::Revoke { proof: w.card.proof(), revocation: issue(robot.key(), &claims).unwrap() };
    expect_refused(&w.ask(&robot, 0, request), "another name", RefusalCode::BadSignature, "");
}

#[test]
fn a_flood_of_revocations_pushes_out_its_own() {
    let mut w = World::with(1, Limits { idle_revocations: 4, ..Limits::default() });
    let (robot, after) = (w.attached("robot", 0), w.serial + 1);
    let by_tool = [(); 2].map(|()| w.another_name());
    for card in &by_tool {
        w.card = card.clone();
        w.revoke(1, after, &[]);
    }
    let flood = |w: &mut World| {
        for _ in 0..20 {
            w.another_name();
            revoke_by_link(w, &robot, after);
        }
    };
    flood(&mut w);
    for card in &by_tool {
        w.card = card.clone();
        expect_refused(&w.publish(&robot, 0, 1), "kept", RefusalCode::Revoked, "");
    }
    // That of a name in use does not count, and takes its place again when the use ends.
    w.serial = after;
    assert!(matches!(w.publish(&robot, 0, 1), Response::Peers(_)));
    let used = w.card.clone();
    for _ in 0..20 {
        w.another_name();
        w.revoke(1, after, &[]);
    }
    flood(&mut w);
    (w.card, w.serial) = (used, after - 1);
    expect_refused(&w.publish(&robot, 0, 2), "in use", RefusalCode::Revoked, "");
    let withdrawal = Parts::withdraw(&w, &robot, 0, 2);
    assert!(matches!(w.ask(&robot, 0, withdrawal), Response::Done));
    expect_refused(&w.publish(&robot, 0, 3), "out of use", RefusalCode::Revoked, "");
}

#[test]
fn each_origin_keeps_its_share_through_a_restart() {
    let limits = Limits { idle_revocations: 8, ..Limits::default() };
    let mut w = World::with(1, limits);
    let (robot, after) = (w.attached("robot", 0), w.serial + 1);
    let honest = [(); 2].map(|()| {
        let card = w.another_name();
        w.revoke(1, after, &[]);
        card
    });
    for run in 2..5 {
        for _ in 0..20 {
            w.another_name();
            revoke_by_link(&mut w, &robot, after);
        }
        let kept = w.rib.signed_revocations();
        assert_eq!(kept.len(), 8);
        let first: Vec<_> = kept[..4].iter().map(|kept| kept.proof.name().unwrap()).collect();
        assert!(honest.iter().all(|card| first.contains(&card.name())), "a file that ends early has them too");
        w.rib = Rib::new(w.switch(0), RibRun { id: run, settling: Duration::ZERO }, limits);
        w.report(0, &[]);
        w.rib.recall(kept.into_iter().map(|kept| (kept.clone(), kept.verify().unwrap())).collect());
        w.attach(&robot, 0);
        for card in &honest {
            w.card = card.clone();
            expect_refused(&w.publish(&robot, 0, 1), "kept", RefusalCode::Revoked, "");
        }
    }
}

#[test]
fn what_stays_because_it_is_used_is_bounded() {
    let mut w = World::with(1, Limits { idle_revocations: 4, used_revocations: 2, ..Limits::default() });
    let (robot, floor) = (w.attached("robot", 0), w.serial);
    let used = [1, 2, 3].map(|serial| {
        let card = w.another_name();
        assert!(matches!(w.publish(&robot, 0, serial), Response::Peers(_)));
        revoke_by_link(&mut w, &robot, floor);
        card
    });
    for _ in 0..20 {
        w.another_name();
        revoke_by_link(&mut w, &robot, floor);
    }
    let is_held = |card: &gdp_core::card::NameCard| w.rib.revocations.claims(card.name().as_bytes()).is_some();
    assert_eq!(used.each_ref().map(is_held), [true, true, false]);
    assert_eq!(w.rib.signed_revocations().len(), 6);
}

#[test]
fn a_rib_after_this_one_knows_what_was_revoked() {
    let mut w = World::chain(1);
    let robot = w.attached("robot", 0);
    let serial = w.serial;
    assert_eq!(w.rib.revocations_taken(), 0);
    assert!(matches!(w.revoke(3, 0, &[serial]), Response::Done));
    assert!(matches!(w.revoke(3, 0, &[serial]), Response::Done));
    assert_eq!(w.rib.revocations_taken(), 1);
    let kept = w.rib.signed_revocations();
    w.rib = Rib::new(w.switch(0), RibRun { id: 2, settling: Duration::ZERO }, Limits::default());
    w.report(0, &[]);
    w.rib.recall(kept.into_iter().map(|kept| (kept.clone(), kept.verify().unwrap())).collect());
    w.attach(&robot, 0);
    w.serial = serial;
    expect_refused(&w.publish(&robot, 0, 1), "again", RefusalCode::Revoked, "AdCert");
    expect_refused(&w.revoke(2, 0, &[]), "taken back", RefusalCode::ReplayedSerial, "2");
}

/// Has an entity bring the owner's revocation of what is below a floor, for the present name.
fn revoke_by_link(w: &mut World, entity: &Identity, floor: u64) {
    let claims = Revocation { name: w.card.name(), number: 1, floor, revoked: vec![], signer: None };
    let request = EntityRequest::Revoke { proof: w.card.proof(), revocation: issue(&w.owner, &claims).unwrap() };
    assert!(matches!(w.ask(entity, 0, request), Response::Done));
}
