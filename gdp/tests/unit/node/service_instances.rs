use std::collections::BTreeMap;

use super::*;
use gdp_core::identity::{Identity, VerifyKey};
use gdp_faults::Random;

const SERVICE: Name = Name::from_bytes([9; 32]);
const FOREVER: u64 = u64::MAX;
const S: u64 = 1_000_000_000;

#[test]
fn the_nearest_is_called_then_the_one_with_the_fewest_calls() {
    let mut parties = ServiceInstances::new(name(0));
    // Two servers are at switch 1, one is further away. One is at a switch without a known path, as
    // in another domain.
    let _ = parties.take(0, &SERVICE, &[joined(1, 1), joined(2, 1), joined(3, 2), joined(4, 7)]);
    let cost = |switch: &Name| BTreeMap::from([(name(1), 5), (name(2), 6)]).get(switch).copied();
    let order = |parties: &ServiceInstances| parties.instances(cost).iter().map(|one| one.name).collect::<Vec<_>>();
    let all = order(&parties);
    assert_eq!(all[2..], [name(3), name(4)]);
    let first = parties.choose(None, cost).unwrap();
    assert_eq!(first.instance, all[0]);
    let second = parties.choose(None, cost).unwrap();
    assert_eq!(second.instance, all[1], "the other of the two that are as near");
    assert_eq!(parties.choose(None, cost).unwrap().instance, all[0], "both have one; the hash decides");
    drop(first);
    assert_eq!((order(&parties)[0], parties.instances(cost)[1].waiting), (all[0], 1));
    assert_eq!(parties.choose(Some(&name(4)), cost).unwrap().instance, name(4), "whichever is nearest");
    assert!(parties.choose(Some(&name(5)), cost).is_none());
    let _ = parties.take(1, &SERVICE, &[PeerEvent::Left(name(1)), PeerEvent::Left(name(2))]);
    assert_eq!(order(&parties), [name(3), name(4)]);
    let _ = parties.take(2, &SERVICE, &[joined(2, 1)]);
    assert_eq!(order(&parties)[0], name(2), "it is back");
    assert_eq!(
        (parties.instances(|_| None).len(), parties.attached_count()),
        (3, 3),
        "without any cost all are as near"
    );
}

#[test]
fn callers_spread_over_servers_that_are_as_near() {
    let chosen = (100..200).map(|caller| {
        let mut parties = ServiceInstances::new(name(caller));
        let _ = parties.take(0, &SERVICE, &[joined(1, 1), joined(2, 1)]);
        parties.choose(None, |_| Some(1)).unwrap().instance
    });
    let first = chosen.filter(|instance| *instance == name(1)).count();
    assert!((20..80).contains(&first), "{first} of 100");
}

#[test]
fn who_has_left_is_told_to_the_calls_that_wait_there_and_to_no_others() {
    let mut parties = ServiceInstances::new(name(0));
    let _ = parties.take(0, &SERVICE, &[joined(1, 1), joined(2, 1), joined(3, 1)]);
    let [one, two, three] = [1, 2, 3].map(|i| parties.choose(Some(&name(i)), |_| None).unwrap());
    let _ = parties.take(1, &SERVICE, &[PeerEvent::Left(name(1))]);
    assert!(one.has_left() && !two.has_left());
    let _ = parties.take(2, &SERVICE, &[joined(1, 1)]);
    assert!(one.has_left(), "its return is of no use to them");
    assert_eq!(parties.instances(|_| None).iter().map(|one| one.waiting).sum::<usize>(), 2);
    let revocation = Revocation { name: SERVICE, number: 1, floor: 0, revoked: vec![2], signer: None };
    let _ = parties.take(3, &SERVICE, &[PeerEvent::Revoked(revocation)]);
    assert_eq!(parties.sweep(3, 0), BTreeSet::from([name(2)]));
    assert!(two.has_left() && !three.has_left());
    assert_eq!(parties.clear(4), BTreeSet::from([name(1), name(3)]));
    assert!(three.has_left());
}

#[test]
fn who_is_absent_keeps_its_place_for_a_while_and_a_right_that_ended_none() {
    let mut parties = ServiceInstances::new(name(0));
    let all: Vec<_> = (1..=MOST_ABSENT as u64 + 2).map(|i| joined(i, 1)).collect();
    assert_eq!(parties.take(0, &SERVICE, &all).len(), all.len());
    for i in 1..=MOST_ABSENT as u64 + 1 {
        let _ = parties.take(i, &SERVICE, &[PeerEvent::Left(name(i))]);
    }
    assert_eq!(parties.sweep(100, 0), BTreeSet::from([name(1)]), "the one longest away");
    assert!(parties.right(&name(2)).is_some());
    assert_eq!(parties.sweep(61 * S, 0).len(), MOST_ABSENT);
    assert_eq!(parties.attached_count(), 1);
    assert_eq!(parties.sweep(61 * S, FOREVER).len(), 0);
    let _ = parties.take(62 * S, &SERVICE, &[PeerEvent::Joined(counterpart(5, 1, 77))]);
    assert_eq!((parties.sweep(62 * S, 77), parties.sweep(62 * S, 78)), (BTreeSet::new(), BTreeSet::from([name(5)])));
    assert!(parties.take(0, &SERVICE, &[joined(0, 1)]).is_empty(), "not oneself");
}

#[test]
fn an_entity_is_believed_for_as_long_as_it_has_a_right_in_any_service() {
    assert_eq!(joint_right(std::iter::empty()), None);
    let (old, new) = (counterpart(1, 1, 100), counterpart(1, 2, 50));
    let joint = joint_right([(7, &old), (8, &new)].into_iter()).unwrap();
    assert_eq!((joint.switch, joint.not_after), (name(2), 100), "what was told last, until the later end");
    assert_eq!(joint_right([(8, &new), (7, &old)].into_iter()), Some(joint));
}

#[test]
fn whatever_happens_the_best_that_is_attached_is_called_and_calls_are_counted() {
    let mut random = Random::new(3);
    let (mut parties, mut attached, mut places) =
        (ServiceInstances::new(name(0)), BTreeMap::new(), Vec::<PendingCall>::new());
    let cost = |switch: &Name| Some(u64::from(switch.as_bytes()[0] % 4)).filter(|cost| *cost < 3);
    for now in 0..3_000 {
        let i = random.below(12) + 1;
        match random.below(4) {
            0 => {
                let switch = random.below(5);
                let _ = parties.take(now, &SERVICE, &[joined(i, switch)]);
                attached.insert(name(i), cost(&name(switch)));
            }
            1 => {
                let _ = parties.take(now, &SERVICE, &[PeerEvent::Left(name(i))]);
                attached.remove(&name(i));
                assert!(places.iter().filter(|place| place.instance == name(i)).all(PendingCall::has_left));
                places.retain(|place| place.instance != name(i));
            }
            2 if !places.is_empty() => {
                places.swap_remove(random.below(places.len() as u64) as usize);
            }
            _ => {
                let waiting = |of: &Name| places.iter().filter(|place| place.instance == *of).count();
                let rank = |(of, cost): (&Name, &Option<u64>)| (cost.unwrap_or(u64::MAX), waiting(of));
                let best = attached.iter().map(rank).min();
                let place = parties.choose(None, cost);
                let chosen = place.as_ref().map(|place| rank((&place.instance, &attached[&place.instance])));
                assert_eq!(chosen, best);
                places.extend(place);
            }
        }
        assert_eq!(parties.instances(cost).iter().map(|one| one.waiting).sum::<usize>(), places.len());
    }
}

fn joined(i: u64, switch: u64) -> PeerEvent {
    PeerEvent::Joined(counterpart(i, switch, FOREVER))
}

fn counterpart(i: u64, switch: u64, not_after: u64) -> Counterpart {
    Counterpart::for_test(name(i), name(switch), key(), not_after, i)
}

fn key() -> VerifyKey {
    Identity::generate("proxy").unwrap().key().verify_key()
}

fn name(i: u64) -> Name {
    let mut bytes = [0; 32];
    bytes[0] = i as u8;
    Name::from_bytes(bytes)
}
