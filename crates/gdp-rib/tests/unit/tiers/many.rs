//! Many parts in one name: what each is told of stays right, and the work is about domains.

use std::sync::Arc;
use std::time::Duration;

use gdp_core::name::Name;
use gdp_proto::control::{NameRole, RecordKey, TierEntry, TierKey, TierRequest, TierResponse};

use super::hostile::Victim;
use super::world::{Random, World, hosted};
use crate::tiers::interest::Interest;
use crate::tiers::{Item, TierLimits, Tiers, table::RecordTable, table::TableRecord};

use NameRole::{Caller, Publisher, Server, Subscriber};

#[test]
fn who_wants_what_is_the_same_as_if_all_parts_were_looked_at() {
    let mut random = Random(1);
    let template = template();
    for _ in 0..500 {
        let part = |random: &mut Random| {
            let role = [Publisher, Subscriber, Server, Caller][random.below(4)];
            let scope = (0..5).filter(|_| role.is_writer() && random.below(3) == 0).map(domain).collect();
            let path = (0..random.below(3)).map(|_| domain(1 + random.below(4))).collect();
            let mut held = TableRecord { scope, path, ..template.clone() };
            held.key.role = role;
            Arc::new(held)
        };
        let home = domain(0);
        let parts: Vec<Arc<TableRecord>> = (0..random.below(8)).map(|_| part(&mut random)).collect();
        let interest = Interest::of(home, parts.iter());
        for other in (0..8).map(|_| part(&mut random)) {
            let meets = |own: &Arc<TableRecord>| {
                let (writer, reader) = if own.key.role.is_writer() { (own, &other) } else { (&other, own) };
                own.key.role.counterpart() == other.key.role
                    && own.origin(home) != other.origin(home)
                    && writer.scope.contains(&reader.origin(home))
            };
            assert_eq!(interest.wants(&other, home), parts.iter().any(meets), "{other:?} of {parts:?}");
        }
        assert!(!interest.is_empty() || parts.iter().all(|held| held.key.role.is_writer() && held.scope.is_empty()));
    }
}

#[test]
fn one_neighbour_fills_no_name() {
    let mut v = Victim::new();
    let home = v.w.domains[0].identity.name();
    let limits = TierLimits { parts_per_name: 2, ..TierLimits::default() };
    v.w.domains[0].tiers = Tiers::new(home, 9, limits);
    v.ask(2, TierRequest::Hello { run: 77, holds: None });
    let part = |v: &mut Victim, topic, entity| TierEntry::Part(Box::new(v.part_in(2, topic, entity, &[0])));
    let all: Vec<TierEntry> = (100..104).map(|entity| part(&mut v, 0, entity)).collect();
    let response = v.push(all.clone());
    let TierResponse::Partly { refused: 2, reason } = &response else { panic!("{response:?}") };
    assert!(reason.contains("2 parts in"), "{reason}");
    assert_eq!((v.entries(), v.counted("name_limit")), (2, 2));
    let (again, other) = (part(&mut v, 0, 100), part(&mut v, 1, 103));
    assert!(matches!(v.push(vec![again, other]), TierResponse::Done), "what replaces one, and another name");
    let gone = TierKey::Part(v.part_in(2, 0, 101, &[0]).record.key().unwrap());
    v.remove(vec![gone]);
    assert!(matches!(v.push(vec![all[2].clone()]), TierResponse::Done), "there is room again");
    assert_eq!((v.entries(), v.counted("name_limit")), (3, 2));
}

#[test]
fn what_there_was_no_room_for_is_told_again() {
    let mut w = World::new(1, &[&[], &[0]]);
    let (home, adjacent) = (w.domains[0].identity.name(), w.adjacent(0));
    let limits = TierLimits { parts_per_name: 1, ..TierLimits::default() };
    w.domains[0].tiers = Tiers::new(home, 9, limits);
    w.domains[0].tiers.set_adjacent(w.now, adjacent);
    let places = [1, 2, 3].map(|entity| w.state(1, 0, entity, Publisher, &[0]));
    w.run(Duration::from_secs(10));
    let name = places[0].name;
    let held = |w: &World| -> Vec<RecordKey> {
        let sides = w.domains[0].tiers.sides.values();
        sides.flat_map(|side| side.table.parts_of(name)).map(|held| held.key).collect()
    };
    let lacking = |w: &World| w.domains[1].tiers.neighbours().next().unwrap().lacking;
    assert_eq!(held(&w).len(), 1);
    let reason = lacking(&w).expect("it says so for as long as it is so");
    assert!(reason.contains("1 parts in"), "{reason}");
    let pushes = w.pushes;
    w.run(Duration::from_secs(600));
    assert!((2..10).contains(&(w.pushes - pushes)), "it is told again, ever more rarely");
    for left in [2, 1] {
        let gone = held(&w)[0];
        w.withdraw(gone);
        w.run(Duration::from_secs(16 * 60 + 30));
        assert_eq!((held(&w).len(), lacking(&w).is_some()), (1, left > 1), "there was room for another");
        assert_ne!(held(&w)[0], gone);
    }
    let pushes = w.pushes;
    // As long as what was stated holds.
    w.run(Duration::from_secs(900));
    assert_eq!(w.pushes, pushes, "all is taken");
}

#[test]
fn what_rests_on_a_domain_or_a_name_is_found_without_looking_at_the_rest() {
    let (mut random, template, mut table) = (Random(2), template(), RecordTable::default());
    for _ in 0..400 {
        let mut held = TableRecord { path: vec![domain(10 + random.below(3)), domain(13)], ..template.clone() };
        (held.key.name, held.key.entity) = (domain(random.below(4)), domain(20 + random.below(6)));
        let key = TierKey::Part(held.key);
        match random.below(3) {
            0 => drop(table.remove(&key)),
            _ => drop(table.insert(key, Item::part(Arc::new(held)))),
        }
        for about in 0..20 {
            let is_concerned =
                |held: &&Arc<TableRecord>| held.key.name == domain(about) || held.path[0] == domain(about);
            let concerned: Vec<_> = table.parts().filter(is_concerned).collect();
            assert_eq!(table.parts_about(domain(about)).collect::<Vec<_>>(), concerned);
        }
    }
}

fn template() -> TableRecord {
    let mut w = World::new(1, &[&[]]);
    let record = w.record(0, 0, 0, Publisher, &[]);
    let (place, host, ends) =
        (record.key().unwrap(), hosted(w.domains[0].identity.name(), &w.domains[0].host), w.now.clock);
    TableRecord { key: place, record, host, path: Vec::new(), scope: Vec::new(), ends }
}

fn domain(i: usize) -> Name {
    Name::from_bytes([i as u8; 32])
}
