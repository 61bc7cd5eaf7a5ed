//! What a neighbour may try to draw or hide what is for an entity in another domain.

use gdp_core::cert::domain::roles;
use gdp_core::cert::{Host, Revocation, issue};
use gdp_core::name::Name;
use gdp_proto::control::{Extent, NameRole, RemoteRecord, TierEntry, TierPush, TierRequest, TierResponse};

use super::hostile::{Victim, flipped};
use super::world::{DAY, UNIX, host};

#[test]
fn a_switch_is_of_no_domain_that_it_does_not_name_itself() {
    let mut v = Victim::new();
    let truth = v.part(3, &[0, 2]);
    let entity = truth.record.entity.name().unwrap();
    let [parent, child, third] = [1, 2, 3].map(|index| v.w.domains[index].identity.name());
    let (right, own) = (truth.host.clone(), v.w.domains[2].host.clone());
    let moved = host(&v.w.domains[2].identity, &v.w.domains[3].switch, roles::SWITCH, UNIX + DAY);
    let Host { proof, membership: issued, .. } = moved.clone();
    let forged = issue(v.w.domains[2].switch.key(), &moved.statement.claims_unverified().unwrap()).unwrap();
    let claim = |host: &Host| {
        let abroad = RemoteRecord { host: host.clone(), path: vec![child], ..truth.clone() };
        vec![TierEntry::Part(Box::new(abroad))]
    };
    for (run, time) in [(1, "before it is known"), (2, "once it is known")] {
        for (what, host, counted) in [
            ("what the switch says", Host { membership: issued.clone(), ..right.clone() }, "wrong_domain"),
            (
                "what another switch signed",
                Host { proof, statement: forged.clone(), membership: issued.clone() },
                "signature",
            ),
            ("nothing but what its domain says", right.clone(), "wrong_domain"),
            ("a switch of its own", own.clone(), "certificate"),
        ] {
            let response = v.push(claim(&host));
            let TierResponse::Partly { refused: 1, reason } = &response else { panic!("{time}, {what}: {response:?}") };
            assert!(reason.contains("which both have to say"), "{time}, {what}: {reason}");
            assert_eq!((v.counted(counted), v.entries()), (1, 0), "{time}, {what}: {reason}");
            v.forget_counts();
        }
        push_by_parent(&mut v, run, RemoteRecord { path: vec![third, parent], ..truth.clone() });
        let known = known_of(&mut v, entity);
        assert_eq!(known, [(vec![third, parent], false)], "it is reached where it is");
    }
    assert!(matches!(v.push(claim(&moved)), TierResponse::Done), "once the switch has said so, too");
}

#[test]
fn a_way_that_is_of_no_use_hides_no_other() {
    let mut v = Victim::new();
    let stranger = Name::from_bytes([9; 32]);
    let [parent, child, third] = [1, 2, 3].map(|index| v.w.domains[index].identity.name());
    let part = |abroad: RemoteRecord| vec![TierEntry::Part(Box::new(abroad))];
    // What the writer had a certificate for before: not for this domain.
    let before = RemoteRecord { path: vec![third, child], ..v.part(3, &[2]) };
    let entity = before.record.entity.name().unwrap();
    assert!(matches!(v.push(part(before.clone())), TierResponse::Done));
    assert_eq!(known_of(&mut v, entity), []);
    let longer = vec![third, stranger, parent];
    let now = RemoteRecord { path: longer.clone(), ..v.part(3, &[0]) };
    push_by_parent(&mut v, 1, now);
    assert_eq!(known_of(&mut v, entity), [(longer.clone(), false)]);

    // Somebody in the child may hear it, and not by way of the child.
    let record = v.w.record(2, 0, 101, NameRole::Subscriber, &[]);
    let reader = RemoteRecord { record, host: v.w.domains[2].host.clone(), path: vec![child] };
    v.push(part(reader));
    push_by_parent(&mut v, 2, RemoteRecord { path: longer.clone(), ..before });
    assert_eq!(known_of(&mut v, entity), [(longer, true)]);
}

#[test]
fn a_switch_that_is_known_is_believed_no_longer_than_it_would_be_otherwise() {
    let mut v = Victim::new();
    v.w.renew(2, UNIX + 10);
    let part = |abroad: RemoteRecord| vec![TierEntry::Part(Box::new(abroad))];
    let first = v.part_in(2, 0, 100, &[0]);
    assert!(matches!(v.push(part(first)), TierResponse::Done));
    let right = v.part_in(2, 1, 101, &[0]);
    let [child, third] = [2, 3].map(|index| v.w.domains[index].identity.name());
    let (mut forged, mut other) = (right.clone(), right.clone());
    forged.host.membership.cert = flipped(&forged.host.membership.cert);
    other.path = vec![third, child];
    for (what, abroad, counted) in [("a forgery", forged, "signature"), ("of another domain", other, "wrong_domain")] {
        v.push(part(abroad));
        assert_eq!((v.counted(counted), v.entries()), (1, 1), "{what}");
        v.forget_counts();
    }
    let now = v.w.now;
    v.w.now.unix = UNIX + 11;
    v.push(part(right.clone()));
    assert_eq!((v.counted("expired"), v.entries()), (1, 1), "the first ends on the clock");
    v.w.now = now;
    assert!(matches!(v.push(part(right.clone())), TierResponse::Done));
    v.w.revocations.0.insert(child, Revocation { name: child, number: 1, floor: 100, revoked: vec![], signer: None });
    let another = v.part_in(2, 2, 102, &[0]);
    v.push(part(another));
    assert_eq!((v.counted("revoked"), v.entries()), (1, 2));
}

/// Of the parent, in a run of its own, and nothing else.
fn push_by_parent(v: &mut Victim, run: u64, abroad: RemoteRecord) {
    let extent = Extent::Full { part: 0, last: true };
    let push = TierPush { run, generation: 1, extent, set: vec![TierEntry::Part(Box::new(abroad))], remove: vec![] };
    let response = v.ask(1, TierRequest::Push(Box::new(push)));
    assert!(matches!(response, TierResponse::Done), "{response:?}");
}

/// The paths of the parts that the own RIB knows of an entity, and whether they only pass.
fn known_of(v: &mut Victim, entity: Name) -> Vec<(Vec<Name>, bool)> {
    let tiers = &mut v.w.domains[0].tiers;
    tiers.take_changes(v.w.now);
    tiers.known_of(entity).parts.into_iter().map(|(held, passes)| (held.path.clone(), passes)).collect()
}
