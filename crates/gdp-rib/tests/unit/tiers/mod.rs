//! Whole federations in simulated time, compared with what each domain should know by all that was
//! stated; and what a hostile neighbour may try.

mod drawn;
mod hostile;
mod many;
mod revoked;
pub mod world;

use std::collections::BTreeSet;
use std::time::Duration;

use gdp_core::cert::Revocation;
use gdp_proto::control::{NameRole, RecordKey, encode};

use super::{Item, RESTART_TIME, SessionState};
use world::{Random, World, owner, pair};

use NameRole::{Caller, Publisher, Server, Subscriber};

/// After so long without changes all is told, whatever cycles had to be found and tried again.
const QUIET: Duration = Duration::from_secs(600);
const MOMENT: Duration = Duration::from_secs(8);

/// ```text
///        0
///      /   \
///     1     2
///    / \     \
///   3   4     5
/// ```
const TREE: &[&[usize]] = &[&[], &[0], &[0], &[1], &[1], &[2]];

#[test]
fn counterparts_hear_of_each_other_across_tiers_and_nobody_else_does() {
    let mut w = World::new(1, TREE);
    w.state(3, 0, 0, Publisher, &[5, 4]);
    w.state(5, 0, 1, Subscriber, &[]);
    w.state(4, 0, 2, Subscriber, &[]);
    w.state(2, 0, 3, Subscriber, &[]);
    w.wrap(3, 0, 0, 1);
    w.wrap(3, 0, 0, 3);
    w.run(MOMENT);
    w.check("one writer");
    let knows = |w: &World, index: usize| w.domains[index].known.values().filter(is_own_part).count();
    assert_eq!([3, 5, 4, 2, 1, 0].map(|index| knows(&w, index)), [2, 1, 1, 0, 0, 0], "2 is out of scope");
    let place = w.state(5, 0, 4, Publisher, &[3, 2]);
    w.state(3, 0, 5, Subscriber, &[]);
    w.run(MOMENT);
    w.check("a writer in each of two domains");
    w.withdraw(place);
    w.run(MOMENT);
    w.check("one withdraws");
    let pushes = w.pushes;
    w.run(QUIET);
    assert_eq!(w.pushes, pushes, "nothing is told while nothing changes");
}

#[test]
fn servers_and_callers_hear_of_each_other_with_keys_for_both() {
    let mut w = World::new(2, TREE);
    w.state(4, 1, 0, Server, &[5]);
    w.state(5, 1, 1, Caller, &[]);
    w.wrap(5, 1, 1, 0);
    w.wrap(4, 1, 0, 1);
    w.run(MOMENT);
    w.check("a call");
}

#[test]
fn what_is_away_for_a_short_time_stays_and_then_it_goes() {
    let mut w = World::new(3, &[&[], &[0], &[0]]);
    w.state(1, 0, 0, Publisher, &[2]);
    w.state(2, 0, 1, Subscriber, &[]);
    w.run(MOMENT);
    w.check("both are there");
    w.set_link((0, 1), false);
    w.run(RESTART_TIME / 2);
    let knows = |w: &World| w.domains[2].known.values().filter(is_own_part).count();
    assert_eq!(knows(&w), 1, "a short partition costs nothing");
    w.run(RESTART_TIME);
    assert_eq!(knows(&w), 0);
    w.set_link((0, 1), true);
    w.run(3 * MOMENT);
    w.check("it is back");
    w.restart(0);
    w.run(3 * MOMENT);
    w.check("the one between has begun anew");
}

#[test]
fn a_neighbour_that_begins_anew_is_understood_at_once() {
    let mut w = World::new(8, &[&[], &[0], &[0]]);
    w.state(2, 0, 0, Subscriber, &[]);
    // So many generations does the parent hold.
    for entity in 1..60 {
        let place = w.state(1, 0, entity, Publisher, &[2]);
        w.run(Duration::from_millis(200));
        w.withdraw(place);
        w.run(Duration::from_millis(200));
    }
    w.state(1, 0, 0, Publisher, &[2]);
    w.run(MOMENT);
    w.check("before");
    let (now, parent, child) = (w.now, w.domains[0].identity.name(), w.domains[1].identity.name());
    w.domains[1].tiers.set_parents(now, vec![]);
    w.domains[1].tiers.set_parents(now, vec![parent]);
    w.state(1, 0, 61, Publisher, &[2]);
    w.run(MOMENT);
    w.check("its parent was none for a moment");

    // The parent misses the child at once, and the child finds out later.
    w.down.insert((0, 1));
    let (now, adjacent) = (w.now, w.adjacent(0));
    w.domains[0].tiers.set_adjacent(now, adjacent);
    w.run(RESTART_TIME + Duration::from_secs(1));
    assert!(w.domains[0].tiers.neighbours().all(|neighbour| neighbour.domain != child));
    assert!(w.domains[1].tiers.neighbours().all(|neighbour| neighbour.entries_in > 0));
    w.set_link((0, 1), true);
    w.state(2, 0, 62, Subscriber, &[]);
    w.run(MOMENT);
    w.check("its parent has forgotten it");
}

#[test]
fn a_second_parent_takes_over() {
    let mut w = World::new(4, &[&[], &[], &[0, 1], &[1, 0]]);
    w.state(2, 0, 0, Publisher, &[3]);
    w.state(3, 0, 1, Subscriber, &[]);
    w.run(MOMENT);
    w.check("two parents each");
    for dead in [0, 1] {
        for child in [2, 3] {
            w.set_link(pair(dead, child), false);
        }
        w.run(2 * RESTART_TIME);
        w.check("one parent is gone");
        for child in [2, 3] {
            w.set_link(pair(dead, child), true);
        }
        w.run(2 * RESTART_TIME);
    }
}

#[test]
fn a_cycle_is_refused_with_a_reason_and_mended_when_it_is_gone() {
    let mut w = World::new(5, &[&[2], &[0], &[1]]);
    w.state(0, 0, 0, Publisher, &[1, 2]);
    w.state(1, 0, 1, Subscriber, &[]);
    w.state(2, 0, 2, Subscriber, &[]);
    w.run(QUIET);
    check_cycles(&w);
    w.check("what is left is a tree");
    let reasons: Vec<String> = w.domains.iter().flat_map(|d| d.tiers.neighbours().collect::<Vec<_>>()).fold(
        Vec::new(),
        |mut reasons, neighbour| {
            if let SessionState::Refused { reason, .. } = neighbour.session {
                assert!(neighbour.refused["cycle"] > 0);
                reasons.push(reason);
            }
            reasons
        },
    );
    assert!(reasons.len() == 1 && reasons[0].contains("`parent: true`"), "{reasons:?}");
    w.domains[0].parents.clear();
    w.restart(0);
    w.run(QUIET);
    assert_eq!(w.accepted(), [BTreeSet::new(), BTreeSet::from([0]), BTreeSet::from([1])]);
    w.check("the cycle is gone");
}

#[test]
fn a_query_that_misses_climbs_and_what_nobody_knows_is_remembered() {
    let mut w = World::new(6, TREE);
    w.state(5, 0, 0, Publisher, &[3]);
    w.run(MOMENT);
    w.query(3, 0);
    w.query(4, 0);
    w.run(MOMENT);
    let found = |w: &mut World| {
        let mut answers: Vec<_> = std::mem::take(&mut w.answers).into_iter().map(|(at, all)| (at, all.len())).collect();
        answers.sort_unstable();
        answers
    };
    assert_eq!(found(&mut w), [(3, 1), (4, 0)], "3 may know it, and 4 may not");
    w.check("who asks is subscribed to nothing");
    let messages = w.messages;
    (0..100).for_each(|_| w.query(3, 7));
    w.run(Duration::from_secs(1));
    let climbed = w.messages - messages;
    assert!(found(&mut w).iter().all(|(_, count)| *count == 0) && climbed <= 210, "{climbed}");
    let messages = w.messages;
    (0..100).for_each(|_| w.query(3, 7));
    w.run(Duration::from_secs(1));
    assert!(w.messages - messages <= 10, "{} messages for what is known to be unknown", w.messages - messages);
    assert_eq!(found(&mut w).len(), 100);
    w.state(5, 7, 0, Publisher, &[3]);
    w.run(2 * MOMENT);
    w.query(3, 7);
    w.run(Duration::from_secs(1));
    assert_eq!(found(&mut w), [(3, 1)]);
    w.set_link((0, 1), false);
    w.query(3, 0);
    w.run(MOMENT);
    assert_eq!(found(&mut w), [(3, 0)], "it is answered though nobody above answers");
}

#[test]
fn what_is_taken_back_is_forgotten_on_the_way() {
    let mut w = World::new(7, TREE);
    w.state(3, 0, 0, Publisher, &[5]);
    w.state(5, 0, 1, Subscriber, &[]);
    w.run(MOMENT);
    w.check("before");
    let domain = w.domains[3].identity.name();
    w.revocations.0.insert(domain, Revocation { name: domain, number: 1, floor: 8, revoked: vec![], signer: None });
    let now = w.now;
    w.domains[0].tiers.reconsider(now, domain, None, &w.revocations);
    w.run(MOMENT);
    assert_eq!(w.domains[5].known.values().filter(is_own_part).count(), 0);
    // The part, and the border that is named in the locator.
    assert!(w.domains[0].tiers.neighbours().any(|neighbour| neighbour.refused.get("revoked") == Some(&2)));
    let name = owner(0).1.name().unwrap();
    w.domains[0].tiers.reconsider(now, name, None, &w.revocations);
}

#[test]
fn a_switch_that_states_again_in_time_is_missed_nowhere() {
    let mut w = World::new(8, TREE);
    let ends = |w: &World| w.now.unix + 600;
    w.renew(3, ends(&w));
    w.state(3, 0, 0, Publisher, &[5]);
    w.state(5, 0, 1, Subscriber, &[]);
    for _ in 0..3 {
        w.run(Duration::from_secs(500));
        w.check("a statement that holds");
        w.renew(3, ends(&w));
    }
    w.run(Duration::from_secs(590));
    w.check("the last one");
    assert_eq!(w.removed, 0, "all the time");
    w.run(Duration::from_secs(20));
    assert_eq!(w.domains[5].known.values().filter(is_own_part).count(), 0, "it has ended");
}

#[test]
fn an_entry_takes_no_more_room_than_it_is_counted_with() {
    let mut w = World::new(9, TREE);
    w.state(3, 0, 0, Publisher, &[5]);
    w.state(5, 0, 1, Subscriber, &[]);
    w.wrap(3, 0, 0, 1);
    w.run(MOMENT);
    let known = &w.domains[5].known;
    assert_eq!(known.len(), 3, "a part, a box, a locator");
    for item in known.values() {
        let (size, counted) =
            (encode(&item.to_entry(w.now.clock, owner(0).1.name().unwrap())).unwrap().len(), item.size());
        assert!(size <= counted, "{size} bytes that count as {counted}: {item:?}");
    }
}

#[test]
fn whatever_happens_every_domain_knows_in_the_end_what_it_should() {
    for seed in 0..40 {
        let mut random = Random(seed);
        let count = 3 + random.below(6);
        // Mostly upward, now and then the other way.
        let parents: Vec<Vec<usize>> = (0..count)
            .map(|index| {
                let mut chosen: Vec<usize> = Vec::new();
                for _ in 0..random.below(3) {
                    let other = if random.below(8) == 0 { random.below(count) } else { random.below(index + 1) };
                    if other != index && !chosen.contains(&other) {
                        chosen.push(other);
                    }
                }
                chosen
            })
            .collect();
        let parents: Vec<&[usize]> = parents.iter().map(Vec::as_slice).collect();
        let mut w = World::new(seed, &parents);
        let mut places: Vec<RecordKey> = Vec::new();
        for step in 0..40 {
            match random.below(10) {
                0..5 => {
                    let (at, topic) = (random.below(count), random.below(4));
                    let writes = random.below(2) == 0;
                    let role = [[Subscriber, Publisher], [Caller, Server]][topic % 2][usize::from(writes)];
                    let scope: Vec<usize> = (0..count).filter(|_| writes && random.below(2) == 0).collect();
                    places.push(w.state(at, topic, step, role, &scope));
                    w.wrap(at, topic, step, random.below(step + 1));
                }
                5 if !places.is_empty() => {
                    let place = places.swap_remove(random.below(places.len()));
                    w.withdraw(place);
                }
                6 | 7 if !w.links.is_empty() => {
                    let links: Vec<_> = w.links.iter().copied().collect();
                    let link = links[random.below(links.len())];
                    w.set_link(link, w.down.contains(&link));
                }
                8 => w.restart(random.below(count)),
                _ => w.query(random.below(count), random.below(5)),
            }
            w.run(Duration::from_millis(random.below(9000) as u64));
        }
        for link in w.down.clone() {
            w.set_link(link, true);
        }
        w.run(QUIET);
        check_cycles(&w);
        w.check(&format!("seed {seed}, parents {parents:?}"));
        let (pushes, messages) = (w.pushes, w.messages);
        w.run(Duration::from_secs(60));
        let hellos = w.messages - messages;
        let edges: usize = parents.iter().map(|parents| parents.len()).sum();
        assert!(hellos <= 2 * 13 * edges as u64 + 12, "seed {seed}: {hellos} messages a minute over {edges} edges");
        let refused = w.domains.iter().flat_map(|d| d.tiers.neighbours().collect::<Vec<_>>());
        if !refused.map(|neighbour| neighbour.session).any(|session| matches!(session, SessionState::Refused { .. })) {
            assert_eq!(w.pushes, pushes, "seed {seed}: nothing is told while nothing changes");
        }
    }
}

/// The parents that are accepted make no cycle; those that are not would.
fn check_cycles(w: &World) {
    let accepted = w.accepted();
    let is_above = |above: usize, below: usize| {
        let (mut seen, mut next) = (BTreeSet::new(), vec![below]);
        while let Some(at) = next.pop() {
            next.extend(accepted[at].iter().filter(|parent| seen.insert(**parent)));
        }
        seen.contains(&above)
    };
    for (index, domain) in w.domains.iter().enumerate() {
        assert!(!is_above(index, index), "domain {index} is above itself");
        for parent in &domain.parents {
            let each_other = w.domains[*parent].parents.contains(&index);
            let is_fit = accepted[index].contains(parent) || each_other || is_above(index, *parent);
            assert!(is_fit, "domain {index} has no reason not to have {parent} for its parent");
        }
    }
}

fn is_own_part(item: &&Item) -> bool {
    matches!(item, Item::Part { only_passes: false, .. })
}
