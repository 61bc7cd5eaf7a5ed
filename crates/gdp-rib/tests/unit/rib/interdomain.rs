//! Entities of several domains: who reaches whom over which border, who is told, what remains when
//! borders and neighbours come and go.

use std::collections::BTreeSet;
use std::time::Duration;

use gdp_core::identity::Identity;
use gdp_core::name::Name;
use gdp_proto::control::{NameRole, RecordKey, RefusalCode, Response};

use super::federation::{Border, Federation, domain, roles};
use super::world::{Parts, Random};
use crate::rib::{BorderLink, Foreign};

use NameRole::{Caller, Publisher, Server, Subscriber};

/// ```text
///   a0 ─ a1 ═══ b0 ─ b1       ═ over a border
/// ```
fn pair() -> Federation {
    Federation::new(&[2, 2], &[(0, 1)], &[Border([(0, 1), (1, 0)], [1, 1])])
}

/// ```text
///   a0 ─ a1 ═══ t0 ─ t1 ═══ b0 ─ b1
///    ╚═════════════════╝
/// ```
fn tree() -> Federation {
    let borders =
        [Border([(0, 1), (1, 0)], [1, 1]), Border([(0, 0), (1, 1)], [1, 1]), Border([(1, 1), (2, 0)], [1, 1])];
    let mut f = Federation::new(&[2, 2, 2], &[(0, 1), (1, 2)], &borders);
    f.transit = vec![(1, 0), (1, 2)];
    f
}

#[test]
fn a_writer_in_one_domain_reaches_a_reader_in_another() {
    let mut f = pair();
    let (writer, reader) = (f.domains[0].attached("writer", 0), f.domains[1].attached("reader", 1));
    f.domains[0].publish(&writer, 0, 1);
    f.settle();
    assert!(f.domains.iter().all(|w| w.routes().is_empty()), "nobody reads");
    f.domains[1].subscribe(&reader, 1, 1);
    f.settle();
    let (name, [a1, b0]) = (f.domains[0].card.name(), [f.switch((0, 1)), f.switch((1, 0))]);
    let [out, far] = [&f.domains[0].held[&a1].routes[&name], &f.domains[1].held[&b0].routes[&name]];
    assert_eq!((&out.locals, &out.writers, out.egress_bits), (&vec![b0], &vec![], 0));
    let bit = 1 << f.domains[1].rib.bit(&f.switch((1, 1))).unwrap();
    assert_eq!((&far.locals, &far.writers, far.egress_bits), (&vec![], &vec![a1], bit));
    assert_eq!(f.domains[1].held[&b0].routes[&writer.name()].arrives_by, [a1]);
    assert_eq!(f.domains[0].held[&a1].routes[&reader.name()].arrives_by, [b0]);
    f.check_delivery();
    f.check_anew();

    f.domains[0].detach(&writer, 0);
    f.settle();
    assert_eq!(f.domains[1].counterparts(&reader, Subscriber), 0);
    assert!(f.domains[1].routes().is_empty());
    assert!(f.domains[1].held.values().all(|held| held.routes.is_empty()), "nor is anything left of its inbox");
    f.domains[1].detach(&reader, 1);
    f.settle();
    f.check_empty();
}

#[test]
fn writers_and_readers_in_both_get_one_copy_each() {
    let mut f = pair();
    for (d, at) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        for role in [Publisher, Subscriber] {
            let entity = f.domains[d].attached("entity", at);
            f.domains[d].state(&entity, at, 1, role);
        }
    }
    f.settle();
    f.check_delivery();
    f.check_anew();
}

/// Its first switch does not miss it yet.
#[test]
fn who_moves_to_another_domain_is_no_longer_reached_where_it_was() {
    let mut f = pair();
    let (writer, reader) = (f.domains[0].attached("writer", 0), f.domains[0].attached("reader", 0));
    f.domains[0].publish(&writer, 0, 1);
    f.domains[0].subscribe(&reader, 0, 1);
    f.settle();
    f.domains[1].attach(&reader, 1);
    f.domains[1].subscribe(&reader, 1, 2);
    f.settle();
    let name = f.domains[0].card.name();
    let places = |f: &Federation, of: usize| -> Vec<Name> {
        f.domains[of].rib.names.all_of(name.as_bytes(), &reader.name(), Subscriber).map(|part| part.switch).collect()
    };
    let far = f.switch((1, 1));
    assert_eq!((places(&f, 0), places(&f, 1)), (vec![far], vec![far]));
    assert_eq!(f.domains[0].held[&f.switch((0, 1))].routes[&name].locals, [f.switch((1, 0))]);
    f.check_delivery();

    f.domains[0].subscribe(&reader, 0, 3);
    f.settle();
    let home = f.switch((0, 0));
    assert_eq!(places(&f, 0), [home]);
    f.check_delivery();
}

#[test]
fn a_service_is_called_from_abroad_and_answers_into_the_inbox() {
    let mut f = pair();
    let (server, caller) = (f.domains[0].attached("server", 0), f.domains[1].attached("caller", 1));
    f.domains[0].state(&server, 0, 1, Server);
    f.domains[1].state(&caller, 1, 1, Caller);
    f.settle();
    f.check_delivery();
    // The caller's keys for what it calls, and the server's for its answers.
    let [own, other] = [server.name(), caller.name()];
    f.domains[1].boxes(&caller, 1, own, 1, &[own]);
    f.domains[0].boxes(&server, 0, other, 1, &[other]);
    f.settle();
    assert!(f.domains[0].given.contains(&(own, other, own, 1)));
    assert!(f.domains[1].given.contains(&(other, own, other, 1)));
}

#[test]
fn keys_cross_to_readers_that_are_there_and_to_no_others() {
    let mut f = pair();
    let (writer, reader) = (f.domains[0].attached("writer", 0), f.domains[1].attached("reader", 1));
    let stranger = Identity::generate("proxy").unwrap().name();
    let name = f.domains[0].card.name();
    f.domains[0].publish(&writer, 0, 1);
    f.domains[1].subscribe(&reader, 1, 1);
    f.settle();
    f.domains[0].boxes(&writer, 0, name, 1, &[reader.name(), stranger]);
    f.settle();
    assert_eq!(f.domains[1].given, BTreeSet::from([(name, writer.name(), reader.name(), 1)]));
    let readers: Vec<_> = f.domains[1].rib.boxes.of(name.as_bytes(), &writer.name()).map(|(r, _)| *r).collect();
    assert_eq!(readers, [reader.name()]);
}

/// A writer of one domain that may be known in its own only, and one that may in both; a reader in
/// each.
#[test]
fn a_scope_ends_at_the_border() {
    let mut f = pair();
    let readers = [0, 1].map(|d| f.domains[d].attached("reader", 0));
    for (w, reader) in f.domains.iter_mut().zip(&readers) {
        w.subscribe(reader, 0, 1);
    }
    f.set_scope(&[]);
    let secret = f.domains[0].attached("writer", 0);
    f.domains[0].publish(&secret, 0, 1);
    f.settle();
    f.check_delivery();
    assert_eq!(f.domains[1].counterparts(&readers[1], Subscriber), 0);
    let name = f.domains[0].card.name().to_string();
    let Response::Records { records, .. } = f.domains[1].query(&name) else { panic!() };
    assert!(records.iter().all(|record| !record.is_writer()), "not even by its name");
    f.set_scope(&[1]);
    let open = f.domains[0].attached("writer", 1);
    f.domains[0].publish(&open, 1, 1);
    f.settle();
    f.check_delivery();
    assert_eq!(f.domains[1].counterparts(&readers[1], Subscriber), 1);
    // It is renewed, for more.
    f.domains[0].publish(&secret, 0, 2);
    f.settle();
    f.check_delivery();
    assert_eq!(f.domains[1].counterparts(&readers[1], Subscriber), 2);
    // And for less.
    f.set_scope(&[]);
    f.domains[0].publish(&secret, 0, 3);
    f.settle();
    assert_eq!(f.domains[1].counterparts(&readers[1], Subscriber), 1);
    f.check_anew();
}

#[test]
fn a_domain_between_relays_for_those_that_may_cross_it() {
    let mut f = tree();
    let (writer, reader) = (f.domains[0].attached("writer", 0), f.domains[2].attached("reader", 1));
    f.domains[0].publish(&writer, 0, 1);
    f.domains[2].subscribe(&reader, 1, 1);
    f.settle();
    f.check_delivery();
    // Its own are not concerned, until they read, too.
    assert_eq!(f.domains[1].rib.names.len(), 1);
    for (d, role) in [(0, Subscriber), (1, Subscriber), (1, Publisher), (2, Publisher)] {
        let entity = f.domains[d].attached("entity", 1);
        f.domains[d].state(&entity, 1, 1, role);
        f.settle();
        f.check_delivery();
        f.check_anew();
    }
    f.transit.clear();
    let sent = f.send((0, f.switch((0, 0))), writer.name(), f.domains[0].card.name());
    assert!(sent.delivered.iter().all(|(d, _)| *d != 2), "{sent:?}");
    assert!(sent.stopped > 0);
}

#[test]
fn what_a_relay_may_not_know_itself_it_passes_on() {
    let mut f = tree();
    f.set_scope(&[2]);
    let (writer, reader) = (f.domains[0].attached("writer", 0), f.domains[2].attached("reader", 1));
    let between = f.domains[1].attached("reader", 0);
    f.domains[0].publish(&writer, 0, 1);
    f.domains[1].subscribe(&between, 0, 1);
    f.domains[2].subscribe(&reader, 1, 1);
    f.settle();
    f.check_delivery();
    assert_eq!(f.domains[1].counterparts(&between, Subscriber), 0);
}

/// Two borders between two domains, of which each side thinks differently: what comes may come by
/// both.
#[test]
fn each_side_chooses_its_way_and_takes_what_comes_by_any() {
    let borders = [Border([(0, 0), (1, 0)], [1, 9]), Border([(0, 1), (1, 1)], [9, 1])];
    let mut f = Federation::new(&[2, 2], &[(0, 1)], &borders);
    for d in [0, 1] {
        for role in [Publisher, Subscriber] {
            let entity = f.domains[d].attached("entity", 0);
            f.domains[d].state(&entity, 0, 1, role);
        }
    }
    f.settle();
    f.check_delivery();
    let name = f.domains[0].card.name();
    let leaves = |f: &Federation, d: usize| -> Vec<usize> {
        let other: BTreeSet<Name> = f.domains[1 - d].switches.iter().map(Identity::name).collect();
        let is_border =
            |i: &usize| f.domains[d].held[&f.switch((d, *i))].routes[&name].locals.iter().any(|l| other.contains(l));
        (0..2).filter(is_border).collect()
    };
    assert_eq!((leaves(&f, 0), leaves(&f, 1)), (vec![0], vec![1]));
    f.borders[0].1 = [9, 1];
    f.borders[1].1 = [1, 9];
    f.set_ways();
    f.settle();
    assert_eq!((leaves(&f, 0), leaves(&f, 1)), (vec![1], vec![0]));
    f.check_delivery();
    f.check_anew();
}

#[test]
fn names_share_the_ways_that_cost_the_same() {
    let borders = [Border([(0, 0), (1, 0)], [5, 5]), Border([(0, 1), (1, 1)], [5, 5])];
    let mut f = Federation::new(&[2, 2], &[(0, 1)], &borders);
    let (writer, reader) = (f.domains[0].attached("writer", 0), f.domains[1].attached("reader", 0));
    let mut used = [0; 2];
    for serial in 1..=32 {
        let card = f.domains[0].another_name();
        f.domains[1].card = card.clone();
        f.domains[0].publish(&writer, 0, serial);
        f.domains[1].subscribe(&reader, 0, serial);
        f.settle();
        for (i, used) in used.iter_mut().enumerate() {
            let route = f.domains[0].held[&f.switch((0, i))].routes.get(&card.name());
            *used += usize::from(route.is_some_and(|route| !route.locals.is_empty()));
        }
    }
    assert_eq!(used[0] + used[1], 32, "each name by one way");
    assert!(used.iter().all(|used| *used > 4), "{used:?}");
    f.check_delivery();
}

#[test]
fn what_is_on_its_way_arrives_after_its_border_is_gone() {
    let borders = [Border([(0, 0), (1, 0)], [1, 1]), Border([(0, 1), (1, 1)], [2, 2])];
    let mut f = Federation::new(&[2, 2], &[(0, 1)], &borders);
    let (writer, reader) = (f.domains[0].attached("writer", 0), f.domains[1].attached("reader", 1));
    f.domains[0].publish(&writer, 0, 1);
    f.domains[1].subscribe(&reader, 1, 1);
    f.settle();
    // Only the reader's side knows that it is gone.
    let (now, kept) = (f.domains[1].now, f.borders.remove(0));
    let ways = f.ways(1);
    f.domains[1].rib.set_ways(now, ways);
    f.settle();
    let send = |f: &Federation| f.send((0, f.switch((0, 0))), writer.name(), f.domains[0].card.name());
    assert_eq!(send(&f).delivered.len(), 1, "it still takes what comes there");
    f.pass(Duration::from_secs(1));
    assert_eq!(send(&f).delivered.len(), 1);
    assert_eq!(f.domains[1].rib.next_tick(), Some(f.domains[1].now.clock + Duration::from_secs(1)));
    f.pass(Duration::from_secs(1));
    f.settle();
    assert_eq!(send(&f).refused, [1]);
    f.set_ways();
    f.settle();
    f.check_delivery();
    f.borders.push(kept);
    f.set_ways();
    f.settle();
    f.check_delivery();
    f.pass(Duration::from_secs(3));
    f.settle();
    f.check_delivery();
    f.check_anew();
}

/// Domains whose records come through a third, and that peer all the same.
#[test]
fn a_direct_way_is_taken_once_both_sides_know_it() {
    let mut f = tree();
    let (writer, reader) = (f.domains[0].attached("writer", 0), f.domains[2].attached("reader", 1));
    f.domains[0].publish(&writer, 0, 1);
    f.domains[2].subscribe(&reader, 1, 1);
    f.settle();
    f.pass(Duration::from_secs(2));
    f.borders.push(Border([(0, 1), (2, 1)], [50, 50]));
    let name = f.domains[0].card.name();
    for d in [2, 0] {
        // One after the other.
        let (now, ways) = (f.domains[d].now, f.ways(d));
        f.domains[d].rib.set_ways(now, ways);
        f.settle();
        f.check_delivery();
    }
    f.pass(Duration::from_secs(2));
    f.settle();
    f.check_delivery();
    let a1 = f.switch((0, 1));
    assert_eq!(f.domains[0].held[&a1].routes[&name].locals, [f.switch((2, 1))]);
    f.borders.pop();
    f.set_ways();
    f.settle();
    f.check_delivery();
    f.check_anew();
}

#[test]
fn of_several_that_tell_the_newest_counts_and_then_the_nearest() {
    let mut f = pair();
    let writer = f.domains[0].attached("writer", 0);
    let foreign = |f: &mut Federation, serial, next: usize, hops| {
        f.domains[0].publish(&writer, 0, serial);
        let (records, _) = f.domains[0].rib.records(f.domains[0].now, None, 1);
        let (record, domain, next) = (records[0].clone(), domain(0), domain(next));
        Foreign { record, domain, next, hops, boxes: vec![], local: true }
    };
    let old = foreign(&mut f, 1, 5, 3);
    let place = old.record.key().unwrap();
    let now = f.domains[1].now;
    let next =
        |f: &Federation| f.domains[1].rib.export(now, &place).and_then(|export| export.origin).map(|(_, next)| next);
    let rib = |f: &mut Federation, foreign: &Foreign| f.domains[1].rib.set_foreign(now, foreign.clone());
    rib(&mut f, &old).unwrap();
    rib(&mut f, &Foreign { next: domain(4), hops: 4, ..old.clone() }).unwrap();
    assert_eq!(next(&f), Some(domain(5)));
    rib(&mut f, &Foreign { next: domain(3), hops: 3, ..old.clone() }).unwrap();
    assert_eq!(next(&f), Some(domain(3)), "of those as near always the same");
    let new = foreign(&mut f, 2, 4, 4);
    rib(&mut f, &new).unwrap();
    assert_eq!(next(&f), Some(domain(4)));
    let refused = rib(&mut f, &Foreign { next: domain(4), ..old.clone() }).unwrap_err();
    assert_eq!(refused.code, RefusalCode::ReplayedSerial, "{refused}");
    f.domains[1].rib.remove_foreign(now, &place, &domain(4));
    assert_eq!(next(&f), Some(domain(3)));
    f.domains[1].rib.remove_foreign_of(now, &domain(3));
    assert_eq!(next(&f), Some(domain(5)));
    f.domains[1].rib.remove_foreign_of(now, &domain(5));
    assert_eq!((next(&f), f.domains[1].rib.name_count()), (None, 0));
}

#[test]
fn what_another_neighbour_says_is_not_lost_for_lack_of_room() {
    let mut f = pair();
    let writer = f.domains[0].attached("writer", 0);
    f.domains[0].publish(&writer, 0, 1);
    let (records, _) = f.domains[0].rib.records(f.domains[0].now, None, 1);
    let (place, now) = (records[0].key().unwrap(), f.domains[1].now);
    let tell = |f: &mut Federation, next: usize| {
        let (record, domain, next, hops) = (records[0].clone(), domain(0), domain(next), next as u32);
        f.domains[1].rib.set_foreign(now, Foreign { record, domain, next, hops, boxes: vec![], local: true })
    };
    tell(&mut f, 4).unwrap();
    tell(&mut f, 5).unwrap();
    assert_eq!(f.domains[1].rib.sources_of(&place), [domain(4), domain(5)]);
    f.domains[1].rib.limits.names = 0;
    f.domains[1].rib.remove_foreign(now, &place, &domain(4));
    assert_eq!((f.domains[1].rib.next_of(&place), f.domains[1].rib.sources_of(&place)), (None, vec![domain(5)]));
    assert_eq!(tell(&mut f, 6).unwrap_err().code, RefusalCode::Limit);
    f.domains[1].rib.limits.names = 1;
    tell(&mut f, 6).unwrap();
    assert_eq!(f.domains[1].rib.next_of(&place), Some(domain(5)), "the nearest");
    for next in [5, 6] {
        f.domains[1].rib.remove_foreign(now, &place, &domain(next));
    }
    assert_eq!((f.domains[1].rib.sources_of(&place), f.domains[1].rib.name_count()), (vec![], 0));
}

#[test]
fn what_is_not_proven_is_not_taken_in() {
    let mut f = pair();
    let writer = f.domains[0].attached("writer", 0);
    f.domains[0].publish(&writer, 0, 1);
    let (records, _) = f.domains[0].rib.records(f.domains[0].now, None, 1);
    let foreign = |record| Foreign { record, domain: domain(0), next: domain(0), hops: 1, boxes: vec![], local: true };
    let (now, good) = (f.domains[1].now, records[0].clone());
    let mut rows = vec![];
    for (what, code) in [
        ("another switch", RefusalCode::WrongSwitch),
        ("another name", RefusalCode::WrongName),
        ("over", RefusalCode::Malformed),
        ("a switch of ours", RefusalCode::WrongSwitch),
    ] {
        let mut record = good.clone();
        match what {
            "another switch" => record.switch = Name::from_bytes([7; 32]),
            "another name" => record.name = Name::from_bytes([7; 32]),
            "over" => record.expires_in = 0,
            _ => record.switch = f.switch((1, 0)),
        }
        rows.push((what, code, foreign(record)));
    }
    for (what, code, foreign) in rows {
        let refused = f.domains[1].rib.set_foreign(now, foreign).unwrap_err();
        assert_eq!(refused.code, code, "{what}: {refused}");
        assert_eq!(f.domains[1].rib.name_count(), 0, "{what}");
    }
    f.domains[1].rib.set_foreign(now, foreign(good.clone())).unwrap();
    // It ends as it says, if nobody says it again.
    f.domains[1].pass(Duration::from_secs(good.expires_in + 1));
    assert_eq!(f.domains[1].rib.name_count(), 0);
    // And the owner takes it back everywhere.
    let mut f = pair();
    let writer = f.domains[0].attached("writer", 0);
    f.domains[0].publish(&writer, 0, 1);
    f.settle();
    assert_eq!(f.domains[1].rib.name_count(), 1);
    let floor = f.domains[0].serial + 1;
    f.domains[1].revoke(1, floor, &[]);
    assert_eq!(f.domains[1].rib.name_count(), 0);
}

#[test]
fn a_neighbour_tells_of_so_much_and_no_more() {
    let mut f = pair();
    f.domains[1].rib.limits.records_per_neighbour = 2;
    let entities = [(); 3].map(|()| f.domains[0].attached("writer", 0));
    let now = f.domains[1].now;
    let mut places = vec![];
    for entity in &entities {
        f.domains[0].publish(entity, 0, 1);
        let role = Publisher;
        places.push(RecordKey {
            name: f.domains[0].card.name(),
            role,
            entity: entity.name(),
            switch: f.switch((0, 0)),
        });
    }
    let tell = |f: &mut Federation, place: &RecordKey| {
        let record = f.domains[0].rib.export(now, place).unwrap().record;
        let (own, boxes) = (domain(0), vec![]);
        f.domains[1].rib.set_foreign(now, Foreign { record, domain: own, next: own, hops: 1, boxes, local: true })
    };
    for round in 0..2 {
        assert!(tell(&mut f, &places[0]).is_ok() && tell(&mut f, &places[1]).is_ok(), "again is not more: {round}");
    }
    assert_eq!(tell(&mut f, &places[2]).unwrap_err().code, RefusalCode::Limit);
    f.domains[1].rib.remove_foreign(now, &places[0], &domain(0));
    tell(&mut f, &places[2]).unwrap();
    let ways =
        (0..20).map(|i| BorderLink { border: f.switch((1, 0)), peer: Name::from_bytes([i; 32]), cost: 1 }).collect();
    f.domains[1].rib.set_ways(now, [(domain(0), ways)].into());
    f.domains[1].pass(Duration::from_secs(3));
    let reader = f.domains[1].attached("reader", 1);
    f.domains[1].subscribe(&reader, 1, 1);
    f.domains[1].settle();
    let route = &f.domains[1].held[&f.switch((1, 0))].routes[&f.domains[0].card.name()];
    assert_eq!(route.writers.len(), f.domains[1].rib.limits.ways_per_domain);
}

/// Statements, moves between domains, borders and neighbours that come and go.
#[test]
fn everybody_is_reached_whatever_happens() {
    const NAMES: usize = 3;
    let mut random = Random(17);
    let loose = [Border([(0, 1), (1, 0)], [1, 2]), Border([(0, 0), (2, 1)], [3, 3]), Border([(1, 0), (2, 1)], [2, 1])];
    for _ in 0..4 {
        let mut f = tree();
        let mut cards = vec![f.domains[0].card.clone()];
        cards.resize_with(NAMES, || f.domains[0].another_name());
        let scopes: Vec<Vec<Name>> =
            cards.iter().map(|_| (0..3).filter(|_| random.below(4) > 0).map(domain).collect()).collect();
        let mut entities: Vec<(Identity, usize, usize, u64)> =
            (0..6).map(|i| (f.domains[i % 3].attached("entity", i / 3), i % 3, i / 3, 0)).collect();
        for step in 0..90 {
            let index = random.below(NAMES);
            f.domains.iter_mut().for_each(|w| w.card = cards[index].clone());
            let of = random.below(6);
            let (identity, d, at, serial) = &mut entities[of];
            *serial += 1;
            match random.below(10) {
                0..=4 => {
                    let role = roles(index)[random.below(2)];
                    f.domains[*d].scope = scopes[index].clone();
                    f.domains[*d].serial += 1;
                    f.domains[*d].state(identity, *at, *serial, role);
                }
                5 => {
                    let request = Parts::withdraw(&f.domains[*d], identity, *at, *serial);
                    f.domains[*d].ask(identity, *at, request);
                }
                6 => {
                    f.domains[*d].detach(identity, *at);
                    (*d, *at) = (random.below(3), random.below(2));
                    f.domains[*d].attach(identity, *at);
                }
                7 => {
                    let toggled = loose[random.below(loose.len())];
                    match f.borders.iter().position(|border| border.0 == toggled.0) {
                        Some(i) => drop(f.borders.remove(i)),
                        None => f.borders.push(toggled),
                    }
                    f.set_ways();
                }
                8 => {
                    f.borders.iter_mut().for_each(|Border(_, costs)| *costs = [1 + step % 3, 1 + step % 2]);
                    f.set_ways();
                }
                _ => f.pass(Duration::from_millis(700)),
            }
            if random.below(3) == 0 {
                f.settle();
                f.check_delivery();
                f.check_anew();
            }
        }
        for (identity, d, at, _) in &entities {
            f.domains[*d].detach(identity, *at);
        }
        f.settle();
        f.check_empty();
    }
}
