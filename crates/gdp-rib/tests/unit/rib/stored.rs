//! What a RIB takes back of what is stored, and what it does not.

#[path = "../../../../gdp-core/tests/unit/published_schema.rs"]
mod schema;

use std::collections::BTreeSet;
use std::time::Duration;

use gdp_core::cert::Revocation;
use gdp_core::identity::Identity;
use gdp_core::name::Name;
use gdp_core::revocations::SignedRevocation;
use gdp_proto::control;
use gdp_proto::control::{NameRole, Record, RefusalCode, Response};

use super::world::{World, expect_refused};
use crate::rib::{Item, RESTART_TIME, RibRun, restore::decode_item, restore::encode_item};

#[test]
fn a_replica_goes_on_where_another_ended() {
    let (mut w, [writer, reader], name) = talking();
    let gone = w.attached("gone", 0);
    w.publish(&gone, 0, 9);
    w.detach(&gone, 0);
    w.store();
    assert_eq!(take_over(&mut w, 2), []);
    (0..2).for_each(|i| w.report(i, &[[writer.name()], [reader.name()]][i]));
    assert!(w.rib.detached.is_empty());
    w.tell_all();
    w.settle();
    w.check_model();
    assert!(w.given.contains(&(name, writer.name(), reader.name(), 1)));
    for (entity, at, serial) in [(&writer, 0, 5), (&reader, 1, 3)] {
        let role = if at == 0 { NameRole::Publisher } else { NameRole::Subscriber };
        expect_refused(&w.state(entity, at, serial, role), "once more", RefusalCode::ReplayedSerial, "replayed serial");
        let response = w.state(entity, at, serial + 1, role);
        assert!(matches!(response, Response::Peers(_)), "{response:?}");
    }
    // All that are forgotten share a floor.
    assert!(matches!(w.attach(&gone, 0), Response::Attached { serial: 9 }));
}

#[test]
fn what_no_switch_reports_ends() {
    let mut w = World::chain(3);
    let entities: Vec<_> = (0..3).map(|i| w.attached("robot", i)).collect();
    (0..3).for_each(|i| drop(w.publish(&entities[i], i, 1)));
    w.store();
    take_over(&mut w, 2);
    assert_eq!(listed(&w), 3);
    // One reports the entity, one that it has none, and one does not report.
    w.report(0, &[entities[0].name()]);
    w.report(1, &[]);
    assert_eq!(listed(&w), 2);
    w.pass(RESTART_TIME);
    assert_eq!(listed(&w), 1);
    w.store();
    let left = |item: &&Item| matches!(item, Item::Registration(_) | Item::Entity(_));
    assert_eq!(w.stored.keys().filter(left).count(), 2, "what has ended is stored no longer");
}

#[test]
fn what_has_ended_meanwhile_is_left_out() {
    let mut w = World::chain(1);
    let writer = w.attached("robot", 0);
    w.publish(&writer, 0, 1);
    w.store();
    w.now.unix += 24 * 3600;
    let omitted = take_over(&mut w, 2);
    assert!(matches!(&omitted[..], [(Item::Registration(_), why)] if why.contains("time is over")), "{omitted:?}");
    // It is written for so long as it was stated, whatever the store says.
    let mut w = World::chain(1);
    let writer = w.attached("robot", 0);
    w.publish(&writer, 0, 1);
    w.store();
    let place = *w.stored.keys().find(|item| matches!(item, Item::Registration(_))).unwrap();
    let before = w.stored[&place].clone();
    w.pass(Duration::from_secs(60));
    take_over(&mut w, 2);
    assert_eq!(w.rib.stored(w.now, &place), Some(before));
}

#[test]
fn items_have_the_published_schema() {
    let (mut w, _, _) = talking();
    w.revoke(1, 0, &[12345]);
    w.store();
    let mut seen = BTreeSet::new();
    for (item, bytes) in &w.stored {
        let rule = match item {
            Item::Floor => "item-floor",
            Item::Switch(_) => "item-switch",
            Item::Revocation(_) => "item-revocation",
            Item::Invitation(_) => "item-invitation",
            Item::Entity(_) => "item-entity",
            Item::Registration(_) => "item-registration",
            Item::KeyBox { .. } => "item-box",
        };
        schema::check(rule, bytes).unwrap_or_else(|error| panic!("{item}: {error}"));
        seen.insert(rule);
    }
    assert_eq!(seen.len(), 5, "{seen:?}");
    let floor = encode_item(&7u64).unwrap();
    schema::check("item-floor", &floor).unwrap();
    schema::check("item-switch", &encode_item(&64u8).unwrap()).unwrap_err();
}

#[test]
fn what_is_stored_is_believed_no_more_than_a_stranger() {
    let (mut w, [writer, _], name) = talking();
    w.revoke(1, 0, &[12345]);
    w.store();
    let honest = w.stored.clone();
    let kinds = |item: &Item| item.to_string().split('/').next().unwrap().to_owned();

    // Any bit of what is signed, and anything under the key of another.
    let proven = proven(&w);
    for (item, bytes) in &honest {
        let is_proven = matches!(item, Item::Registration(_) | Item::Revocation(_) | Item::KeyBox { .. });
        for at in (0..bytes.len()).step_by(7).filter(|_| is_proven) {
            w.stored = honest.clone();
            w.stored.get_mut(item).unwrap()[at] ^= 1;
            take_over(&mut w, 2);
            assert!(self::proven(&w).is_subset(&proven), "{item}, byte {at}");
        }
        let others = honest.keys().filter(|other| is_proven && *other != item && kinds(other) == kinds(item));
        for other in others {
            w.stored = honest.clone();
            w.stored.insert(*other, bytes.clone());
            let omitted = take_over(&mut w, 2);
            let is_omitted = |(item, why): &(Item, String)| item == other && why.contains("key of another");
            assert!(omitted.iter().any(is_omitted), "{omitted:?}");
        }
    }

    // A revocation of somebody else's making.
    let elsewhere = super::world::World::chain(1);
    let claims = Revocation { name, number: 9, floor: u64::MAX, revoked: vec![], signer: None };
    let revocation = gdp_core::cert::issue(&elsewhere.owner, &claims).unwrap();
    let forged = SignedRevocation { proof: w.card.proof(), revocation, origin: None };
    w.stored = honest.clone();
    w.stored.insert(Item::Revocation(name), encode_item(&forged).unwrap());
    take_over(&mut w, 2);
    assert_eq!(listed(&w), 2);

    // Floors without end, bits that are none, and versions to come.
    w.stored = honest.clone();
    w.stored.insert(Item::Floor, encode_item(&u64::MAX).unwrap());
    w.stored.insert(Item::Switch(Name::from_bytes([9; 32])), encode_item(&200u8).unwrap());
    let omitted = take_over(&mut w, 2);
    assert!(omitted.iter().any(|(item, _)| matches!(item, Item::Switch(_))), "{omitted:?}");
    let another = Identity::generate("proxy").unwrap();
    let Response::Attached { serial } = w.attach(&another, 0) else { panic!("not attached") };
    let response = w.publish(&another, 0, serial + 1);
    assert!(matches!(response, Response::Peers(_)), "some serials are left to everybody: {response:?}");
    assert!(decode_item::<u64>(&[0x82, 2, 1]).unwrap_err().to_string().contains("version 2"));

    // What is left of an entity without its floor: the serials that its records show.
    w.stored = honest;
    w.stored.remove(&Item::Entity(writer.name()));
    take_over(&mut w, 2);
    w.attach(&writer, 0);
    assert_eq!(listed(&w), 1, "what was bound to its attachment is gone");
}

/// A writer at the first of two switches and a reader at the second, of the name, with a key for
/// the reader.
fn talking() -> (World, [Identity; 2], Name) {
    let mut w = World::chain(2);
    let (writer, reader) = (w.attached("robot", 0), w.attached("cloud", 1));
    w.publish(&writer, 0, 5);
    w.subscribe(&reader, 1, 3);
    let name = w.card.name();
    w.boxes(&writer, 0, name, 1, &[reader.name()]);
    (w, [writer, reader], name)
}

fn take_over(w: &mut World, id: u64) -> Vec<(Item, String)> {
    w.take_over(RibRun { id, settling: w.now.clock + RESTART_TIME })
}

/// All that somebody has signed.
fn proven(w: &World) -> BTreeSet<Vec<u8>> {
    let (records, _) = w.rib.records(w.now, None, usize::MAX);
    let records = records.into_iter().map(|record| Record { expires_in: 0, ..record });
    let mut all: BTreeSet<_> = records.map(|record| control::encode(&record).unwrap()).collect();
    all.extend(w.rib.signed_revocations().iter().map(|kept| kept.revocation.as_bytes().to_vec()));
    all.extend(
        w.stored.keys().filter(|item| matches!(item, Item::KeyBox { .. })).filter_map(|item| w.rib.stored(w.now, item)),
    );
    all
}

fn listed(w: &World) -> usize {
    w.rib.records(w.now, None, usize::MAX).0.len()
}
