//! What an entity believes of what its RIB tells, and what it does not.

use super::*;
use crate::control::Credential;
use gdp_core::cert::{AdCert, Advert, AdvertOp, Grantee, MemberCert, ReadGrant, Reading, Revocation, issue};
use gdp_core::identity::{Identity, SigningKey};

const NOW: u64 = 150;

#[test]
fn who_comes_and_goes_is_told_once() {
    let mut w = World::new();
    let [a, b, c] = [0, 1, 2].map(|_| Identity::generate("proxy").unwrap());
    let joined = |events: &[PeerEvent]| {
        let joined = events.iter().filter_map(|e| if let PeerEvent::Joined(c) = e { Some(c.entity) } else { None });
        joined.collect::<Vec<_>>()
    };
    let events = w.whole(&[w.reader(&a, 1), w.reader(&b, 2)]);
    assert_eq!(joined(&events), [a.name(), b.name()]);
    assert_eq!(w.held.get(&a.name()).unwrap().box_key, a.box_public());
    assert_eq!(w.whole(&[w.reader(&a, 1), w.reader(&b, 2)]), [], "the same again is no news");
    let events = w.changes(&[w.reader(&c, 3)], &[a.name()]);
    assert_eq!((joined(&events), &events[1..]), (vec![c.name()], &[PeerEvent::Left(a.name())][..]));
    let events = w.whole(&[w.reader(&b, 4)]);
    assert_eq!((joined(&events), &events[1..]), (vec![b.name()], &[PeerEvent::Left(c.name())][..]), "another grant");
    assert_eq!(w.held.expire(NOW + 51), [PeerEvent::Left(b.name())]);
}

#[test]
fn a_rib_that_has_just_started_takes_nobody_away_by_not_knowing_him() {
    let mut w = World::new();
    let [a, b] = [0, 1].map(|_| Identity::generate("proxy").unwrap());
    w.whole(&[w.reader(&a, 1), w.reader(&b, 2)]);
    let extent = PeersExtent::Whole { part: 0, last: true };
    let records = vec![w.reader(&a, 1)];
    let settling = Peers { run: 2, settling: true, extent, records, ..w.nothing() };
    assert_eq!(w.take(settling), []);
    assert!(w.held.get(&b.name()).is_some());
    let gone = Peers { run: 2, settling: true, departed: vec![a.name()], ..w.nothing() };
    assert_eq!(w.take(gone), [PeerEvent::Left(a.name())], "it says so");
    let settled = Peers { run: 2, extent, ..w.nothing() };
    assert_eq!(w.take(settled), [PeerEvent::Left(b.name())]);
}

#[test]
fn who_reads_for_a_role_reads_no_more_once_its_domain_takes_it_back() {
    let (mut w, domain) = (World::new(), Identity::generate("domain").unwrap());
    let [stolen, other, named] = [0, 1, 2].map(|_| Identity::generate("proxy").unwrap());
    let by_role = |entity: &Identity, serial| {
        let (role, not_before, not_after) = ("operator".to_owned(), 100, 200);
        let to = Grantee::Role { domain: domain.name(), role: role.clone() };
        let grant = ReadGrant { name: w.name, to, serial: 1, not_before, not_after };
        let (domain_name, entity_name) = (domain.name(), entity.name());
        let cert = MemberCert { domain: domain_name, entity: entity_name, role, serial, not_before, not_after };
        let member = Some(Membership::issue(&domain, &cert).unwrap());
        let reading = Reading { grant: issue(&w.owner, &grant).unwrap().into(), member: member.map(Box::new) };
        w.record(entity, AdvertOp::Subscribe, Credential::Reader(reading))
    };
    let [first, second, again] = [by_role(&stolen, 7), by_role(&other, 8), by_role(&stolen, 9)];
    let all = [first.clone(), second, w.reader(&named, 7)];
    assert_eq!(w.whole(&all).len(), 3);
    let claims = Revocation { name: domain.name(), number: 1, floor: 0, revoked: vec![7], signer: None };
    let of_another = Revocation { name: Name::from_bytes([1; 32]), ..claims.clone() };
    assert_eq!(w.held.domain_revoked(&of_another), []);
    assert_eq!(w.held.domain_revoked(&claims), [PeerEvent::Expelled(stolen.name())]);
    assert!(w.held.get(&other.name()).is_some() && w.held.get(&named.name()).is_some());
    let events = w.changes(&[first], &[]);
    assert!(matches!(&events[..], [PeerEvent::Refused(CertError::Revoked { serial: 7, .. })]), "{events:?}");
    assert!(matches!(&w.changes(&[again], &[])[..], [PeerEvent::Joined(_)]), "it is a member anew");
}

#[test]
fn what_is_lost_or_comes_late_is_noticed() {
    let mut w = World::new();
    let [a, b] = [0, 1].map(|_| Identity::generate("proxy").unwrap());
    let (record_a, record_b) = (w.reader(&a, 1), w.reader(&b, 2));
    let part = |w: &World, run, generation, extent, records: &[&Record]| {
        let records = records.iter().map(|record| (*record).clone()).collect();
        Peers { run, generation, extent, records, ..w.nothing() }
    };
    let whole = |part, last| PeersExtent::Whole { part, last };
    for (what, run, generation, extent, follows) in [
        ("a change before anything", 1, 10, PeersExtent::After(9), false),
        ("a second part before the first", 1, 10, whole(1, true), false),
        ("the first part", 1, 10, whole(0, false), true),
        ("a change before the last part", 1, 11, PeersExtent::After(10), false),
        ("the third part", 1, 12, whole(2, true), false),
        ("the second part", 1, 12, whole(1, false), true),
        ("the second part again", 1, 12, whole(1, false), false),
        ("the last part", 1, 20, whole(2, true), true),
        ("a change", 1, 30, PeersExtent::After(20), true),
        ("an older whole", 1, 25, whole(0, true), false),
        ("a change that follows another", 1, 40, PeersExtent::After(31), false),
        ("a change of another run", 2, 40, PeersExtent::After(30), false),
        ("a whole of another run", 2, 1, whole(0, true), true),
    ] {
        let peers = part(&w, run, generation, extent, &[]);
        assert_eq!(w.held.take(NOW, &peers).is_ok(), follows, "{what}");
    }
    let mut take = |generation, extent, records: &[&Record]| {
        let peers = part(&w, 2, generation, extent, records);
        w.held.take(NOW, &peers).unwrap()
    };
    take(2, whole(0, true), &[&record_a]);
    take(3, whole(0, false), &[&record_b]);
    let events = take(4, whole(1, true), &[]);
    assert_eq!(events, [PeerEvent::Left(a.name())], "only the last part says who is gone");
}

#[test]
fn a_rib_that_lies_makes_nobody_a_counterpart() {
    let mut w = World::new();
    let (robot, rogue) = (Identity::generate("proxy").unwrap(), Identity::generate("proxy").unwrap());
    let honest = w.reader(&robot, 1);
    let other = World::new();
    for (what, record) in [
        ("a grant for another", Record { entity: rogue.proof(), ..honest.clone() }),
        ("a grant of another owner", Record { credential: other.reader(&robot, 1).credential, ..honest.clone() }),
        ("a statement at another switch", Record { switch: robot.name(), ..honest.clone() }),
        ("a record of another name", other.reader(&robot, 1)),
        ("a publisher", w.writer(&robot)),
        ("a caller", w.record(&robot, AdvertOp::Call, w.grant(&robot, 1))),
    ] {
        let events = w.whole(&[record]);
        assert!(matches!(events[..], [PeerEvent::Refused(_)]), "{what}: {events:?}");
    }
    assert_eq!(w.held.known().count(), 0);
    let events = w.whole(&[Record { name: other.name, ..honest.clone() }, honest]);
    assert!(matches!(events[..], [PeerEvent::Refused(_), PeerEvent::Joined(_)]), "one lie spoils nothing else");
}

#[test]
fn a_revocation_counts_whoever_still_tells_of_what_it_took_back() {
    let mut w = World::new();
    let [a, b] = [0, 1].map(|_| Identity::generate("proxy").unwrap());
    w.whole(&[w.reader(&a, 1), w.reader(&b, 2)]);
    let events = w.revocation(&w.owner.clone(), 7, &[1]);
    let [PeerEvent::Revoked(revoked), PeerEvent::Left(gone)] = &events[..] else { panic!("{events:?}") };
    assert_eq!((revoked.number, *gone), (7, a.name()));
    let events = w.whole(&[w.reader(&a, 1), w.reader(&b, 2)]);
    let [PeerEvent::RibIsBehind(newest), PeerEvent::Refused(CertError::Revoked { serial: 1, .. })] = &events[..] else {
        panic!("{events:?}")
    };
    assert_eq!(newest.claims_unverified().unwrap().number, 7, "a RIB that forgot it is to be given it");
    assert_eq!(w.revocation(&w.owner.clone(), 7, &[1]), [], "the same again");
    for (number, serials) in [(6, vec![]), (7, vec![2])] {
        let events = w.revocation(&w.owner.clone(), number, &serials);
        let [PeerEvent::Refused(CertError::RolledBack { known: 7, .. }), PeerEvent::RibIsBehind(_)] = events[..] else {
            panic!("{events:?}")
        };
    }
    let events = w.revocation(&SigningKey::generate().unwrap(), 8, &[2]);
    assert!(matches!(events[..], [PeerEvent::Refused(CertError::WrongKey { .. })]), "{events:?}");
    assert_eq!(w.held.known().map(|c| c.entity).collect::<Vec<_>>(), [b.name()]);
    let events = w.changes(&[w.reader(&a, 3)], &[]);
    assert!(matches!(events[..], [PeerEvent::Joined(_)]), "under a new grant: {events:?}");
}

/// A publisher of a name, and what its RIB can tell it.
struct World {
    owner: SigningKey,
    proof: NameProof,
    name: Name,
    held: Counterparts,
    generation: u64,
}

impl World {
    fn new() -> Self {
        let owner = SigningKey::generate().unwrap();
        let proof = NameProof { owner_key: owner.public(), digest: [7; 32] };
        let held = Counterparts::new(proof, NameRole::Publisher).unwrap();
        Self { owner, proof, name: proof.name().unwrap(), held, generation: 0 }
    }

    fn nothing(&self) -> Peers {
        let extent = PeersExtent::After(self.generation);
        let (run, generation, departed, boxes) = (1, self.generation + 1, vec![], vec![]);
        Peers { run, settling: false, generation, extent, records: vec![], departed, revocation: None, boxes }
    }

    fn whole(&mut self, records: &[Record]) -> Vec<PeerEvent> {
        let extent = PeersExtent::Whole { part: 0, last: true };
        self.take(Peers { extent, records: records.to_vec(), ..self.nothing() })
    }

    fn changes(&mut self, records: &[Record], gone: &[Name]) -> Vec<PeerEvent> {
        self.take(Peers { records: records.to_vec(), departed: gone.to_vec(), ..self.nothing() })
    }

    fn revocation(&mut self, owner: &SigningKey, number: u64, revoked: &[u64]) -> Vec<PeerEvent> {
        let claims = Revocation { name: self.name, number, floor: 0, revoked: revoked.to_vec(), signer: None };
        self.take(Peers { revocation: Some(issue(owner, &claims).unwrap()), ..self.nothing() })
    }

    fn take(&mut self, peers: Peers) -> Vec<PeerEvent> {
        self.generation = peers.generation;
        self.held.take(NOW, &peers).unwrap()
    }

    fn reader(&self, entity: &Identity, serial: u64) -> Record {
        self.record(entity, AdvertOp::Subscribe, self.grant(entity, serial))
    }

    fn writer(&self, entity: &Identity) -> Record {
        let (name, scope, serial, not_before, not_after) = (self.name, vec![], 1, 100, 200);
        let cert = AdCert { name, entity: entity.name(), scope, serial, not_before, not_after };
        self.record(entity, AdvertOp::Publish, Credential::Writer(issue(&self.owner, &cert).unwrap().into()))
    }

    fn grant(&self, entity: &Identity, serial: u64) -> Credential {
        let (to, not_before, not_after) = (Grantee::Entity(entity.name()), 100, 200);
        let grant = ReadGrant { name: self.name, to, serial, not_before, not_after };
        Credential::Reader(issue(&self.owner, &grant).unwrap().into())
    }

    fn record(&self, entity: &Identity, op: AdvertOp, credential: Credential) -> Record {
        let (name, switch, box_key) = (self.name, Name::from_bytes([9; 32]), entity.box_public());
        let advert = Advert { op, name, entity: entity.name(), switch, serial: 1, lifetime: 60, box_key };
        let advert = issue(entity.key(), &advert).unwrap();
        Record { name, proof: self.proof, entity: entity.proof(), switch, credential, advert, expires_in: 60 }
    }
}
