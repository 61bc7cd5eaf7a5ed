//! What the owner of a name takes back is heard by the RIBs of all domains that have to do with the
//! name, and by no others.

use std::time::Duration;

use gdp_core::cert::{Advert, AdvertOp, Grantee, MemberCert, Membership, ReadGrant, Reading, Revocation, issue};
use gdp_core::revocations::SignedRevocation;
use gdp_proto::control::{Credential, NameRole, TierEntry, TierKey, TierResponse};
use gdp_wire::Name;

use super::RESTART_TIME;
use super::hostile::Victim;
use super::world::{DAY, UNIX, World, hosted, identity, owner, revocation};
use crate::tiers::{side::MAX_REVOKED_NAMES, side::SentUpdate};

use NameRole::{Publisher, Subscriber};

/// ```text
///        0
///      /   \
///     1     2
///    / \   / \
///   3   4 5   6
/// ```
const TREE: &[&[usize]] = &[&[], &[0], &[0], &[1], &[1], &[2], &[2]];
const MOMENT: Duration = Duration::from_secs(8);

#[test]
fn a_reader_that_is_revoked_where_the_writer_is_ends_where_it_reads() {
    let mut w = World::new(1, TREE);
    w.state(3, 0, 0, Publisher, &[4, 5]);
    let stolen = w.state(5, 0, 1, Subscriber, &[]);
    w.state(4, 0, 2, Subscriber, &[]);
    w.state(6, 1, 3, Subscriber, &[]);
    w.run(MOMENT);
    w.check("before");
    let (record, serial) = (w.domains[5].parts[&stolen].record.clone(), serial(&w, 5, 0));
    w.revoke(3, 0, 1, vec![serial]);
    w.run(MOMENT);
    assert!(w.domains[5].parts.is_empty(), "its own RIB has heard of it");
    w.check("it is revoked");
    assert_eq!(aware(&w, 0), [0, 1, 2, 3, 4, 5], "and all between, but nobody else");

    // Its RIB lies, or forgets.
    let (now, host) = (w.now, hosted(w.domains[5].identity.name(), &w.domains[5].host));
    w.domains[5].tiers.set_own(now, record, host).unwrap();
    w.run(MOMENT);
    let refused = |of: usize, from: usize| {
        let from = w.domains[from].identity.name();
        let neighbour = w.domains[of].tiers.neighbours().find(|neighbour| neighbour.domain == from).unwrap();
        neighbour.refused.get("revoked").copied()
    };
    assert_eq!([refused(2, 5), refused(0, 2)], [Some(2), Some(1)], "when it was taken back, and said again");
    let messages = w.pushes;
    w.run(Duration::from_secs(50));
    assert_eq!(w.pushes, messages);
}

#[test]
fn who_was_away_hears_of_it_once_it_says_what_holds_no_more() {
    let mut w = World::new(2, TREE);
    w.state(3, 0, 0, Publisher, &[5]);
    w.state(5, 0, 1, Subscriber, &[]);
    w.run(MOMENT);
    let serial = serial(&w, 5, 0);
    w.set_link((0, 2), false);
    w.run(2 * RESTART_TIME);
    w.revoke(3, 0, 1, vec![serial]);
    w.run(2 * RESTART_TIME);
    assert_eq!((aware(&w, 0), w.domains[5].parts.len()), (vec![0, 1, 3], 1));
    w.set_link((0, 2), true);
    w.run(2 * MOMENT);
    assert_eq!((aware(&w, 0), w.domains[5].parts.len()), (vec![0, 1, 2, 3, 5], 0));
    w.check("it is back");

    // The newest counts, wherever the owner brings it.
    let other = w.state(5, 0, 4, Subscriber, &[]);
    w.run(MOMENT);
    w.check("another reader");
    w.revoke(5, 0, 2, vec![serial, self::serial(&w, 5, 0)]);
    w.run(MOMENT);
    assert!(!w.domains[5].parts.contains_key(&other));
    let name = owner(0).1.name().unwrap();
    assert!(aware(&w, 0).iter().all(|index| w.domains[*index].owners[&name].1.number == 2));
    w.check("another is revoked");
}

#[test]
fn what_an_owner_did_not_sign_is_refused_and_what_is_older_is_answered() {
    let mut v = Victim::new();
    let tell = |SignedRevocation { proof, revocation, .. }: SignedRevocation| {
        vec![TierEntry::Revocation { proof, revocation }]
    };
    let forged = SignedRevocation { proof: owner(1).1, ..revocation(0, 1, vec![1]) };
    let response = v.push(tell(forged));
    assert!(matches!(response, TierResponse::Partly { refused: 1, .. }), "{response:?}");
    assert_eq!((v.counted("signature"), v.entries(), v.w.domains[0].tiers.take_revoked().len()), (1, 0, 0));
    let known = revocation(0, 7, vec![1, 2]);
    assert!(matches!(v.push(tell(known.clone())), TierResponse::Done));
    assert_eq!(v.w.domains[0].tiers.take_revoked(), [known]);
    assert_eq!(v.entries(), 0, "nothing of it is held here");
}

#[test]
fn who_reads_for_a_role_that_its_domain_takes_back_is_forgotten() {
    let mut v = Victim::new();
    let (third, entity) = (v.w.domains[3].identity.clone(), identity("proxy", 100));
    let mut part = v.part(2, &[]);
    let name = part.record.name;
    let (role, serial, not_before, not_after) = ("operator".to_owned(), 7, UNIX - DAY, UNIX + DAY);
    let to = Grantee::Role { domain: third.name(), role: role.clone() };
    let grant = ReadGrant { name, to, serial, not_before, not_after };
    let cert = MemberCert { domain: third.name(), entity: entity.name(), role, serial, not_before, not_after };
    let member = Some(Membership::issue(&third, &cert).unwrap());
    let reading = Reading { grant: issue(&owner(0).0, &grant).unwrap().into(), member: member.map(Box::new) };
    let advert = Advert { op: AdvertOp::Subscribe, ..part.record.advert.claims_unverified().unwrap() };
    part.record.credential = Credential::Reader(reading);
    part.record.advert = issue(entity.key(), &advert).unwrap();
    let entry = || vec![TierEntry::Part(Box::new(part.clone()))];
    assert!(matches!(v.push(entry()), TierResponse::Done));
    v.w.revocations
        .0
        .insert(third.name(), Revocation { name: third.name(), number: 1, floor: 8, revoked: vec![], signer: None });
    let now = v.w.now;
    v.w.domains[0].tiers.reconsider(now, third.name(), None, &v.w.revocations);
    assert_eq!((v.entries(), v.counted("revoked")), (0, 1));
    v.push(entry());
    assert_eq!((v.entries(), v.counted("revoked")), (0, 2));
}

#[test]
fn one_neighbour_is_told_of_so_many_names() {
    let (mut told, kept) = (SentUpdate::default(), revocation(0, 1, vec![1]));
    let name = |i: usize| Name::from_bytes([(i >> 8) as u8, i as u8].repeat(16).try_into().unwrap());
    let all = MAX_REVOKED_NAMES + 10;
    (0..all).for_each(|i| told.tell_revoked(name(i), &kept));
    (0..all).rev().for_each(|i| told.tell_revoked(name(i), &kept));
    assert_eq!(told.feed.entries().len(), MAX_REVOKED_NAMES);
    assert!(told.feed.entries().contains_key(&TierKey::Revocation(name(0))), "the one that came last");
}

/// The serial of the only certificate that somebody in this domain shows for a topic.
fn serial(w: &World, at: usize, topic: usize) -> u64 {
    let name = owner(topic).1.name().unwrap();
    let mut of = w.domains[at].parts.values().filter(|part| part.record.name == name);
    of.next().unwrap().record.credential.serials().unwrap()[0].1
}

/// The domains whose RIBs know that something was taken back of a topic.
fn aware(w: &World, topic: usize) -> Vec<usize> {
    let name = owner(topic).1.name().unwrap();
    (0..w.domains.len()).filter(|index| w.domains[*index].owners.contains_key(&name)).collect()
}
