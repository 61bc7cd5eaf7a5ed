//! Random joins, leaves, moves, second links, link failures, revocations, key boxes, restarts of
//! the RIB and lost messages. Whatever happened: FIBs that follow the pushes equal the desired ones
//! and a model's, what is sent reaches exactly those that take it, and everybody knows its
//! counterparts and has the boxes that are kept for it.

use std::collections::BTreeSet;
use std::time::Duration;

use gdp_core::identity::Identity;
use gdp_core::name::Name;
use gdp_proto::control;
use gdp_proto::control::NameRole;

use super::world::{Parts, Random, World};
use crate::rib::{Limits, Rib, RibRun};

const SWITCHES: usize = 6;
const ENTITIES: usize = 8;
const NAMES: usize = 4;

/// Links that come and go.
const LOOSE: [(usize, usize); 2] = [(0, 3), (2, 5)];

struct Entity {
    identity: Identity,
    at: usize,
    /// Where its other lane is.
    also: Option<usize>,
    serial: u64,
}

impl Entity {
    fn is_at(&self, switch: usize) -> bool {
        self.at == switch || self.also == Some(switch)
    }
}

#[test]
fn pushes_bring_everything_to_its_desired_state_whatever_happens() {
    let mut random = Random(11);
    for round in 0..4 {
        let mut w = World::chain(SWITCHES);
        w.loss = 4;
        w.links.extend(LOOSE);
        w.rewire();
        let mut entities: Vec<Entity> = (0..ENTITIES)
            .map(|_| {
                let at = random.below(SWITCHES);
                Entity { identity: w.attached("entity", at), at, also: None, serial: 0 }
            })
            .collect();
        let mut cards = vec![w.card.clone()];
        cards.resize_with(NAMES, || w.another_name());
        for step in 0..80 {
            // Names of even index are topics, the others services.
            let index = random.below(NAMES);
            w.card = cards[index].clone();
            let [writer, reader] = match index % 2 {
                0 => [NameRole::Publisher, NameRole::Subscriber],
                _ => [NameRole::Server, NameRole::Caller],
            };
            let names: BTreeSet<Name> = entities.iter().map(|entity| entity.identity.name()).collect();
            let Entity { identity, at, also, serial } = &mut entities[random.below(ENTITIES)];
            *serial += 1;
            w.serial += 1;
            match random.below(14) {
                0..=2 => drop(w.state(identity, *at, *serial, writer)),
                3..=5 => drop(w.state(identity, *at, *serial, reader)),
                6 => {
                    let request = Parts::withdraw(&w, identity, *at, *serial);
                    w.ask(identity, *at, request);
                }
                7 => {
                    *at = random.below(SWITCHES);
                    w.attach(identity, *at);
                }
                8 => {
                    let toggled = LOOSE[random.below(LOOSE.len())];
                    match w.links.iter().position(|link| *link == toggled) {
                        Some(i) => drop(w.links.remove(i)),
                        None => w.links.push(toggled),
                    }
                    w.rewire();
                }
                9 => {
                    let readers: Vec<Name> = names.into_iter().collect();
                    let name = w.card.name();
                    w.boxes(identity, *at, name, step, &readers);
                    // A counterpart's inbox, if it is one.
                    let inbox = readers[random.below(ENTITIES)];
                    w.boxes(identity, *at, inbox, step, &[inbox]);
                }
                10 => {
                    let (records, _) = w.rib.records(w.now, None, usize::MAX);
                    let of_name = records.iter().filter(|record| record.name == w.card.name());
                    let serials =
                        of_name.flat_map(|record| record.credential.serials().unwrap()).map(|(_, serial)| serial);
                    let serials: BTreeSet<u64> = serials.collect();
                    let revoked: Vec<u64> = serials.into_iter().filter(|_| random.below(3) == 0).collect();
                    w.revoke(u64::from(step) + 1, 0, &revoked);
                    let (records, _) = w.rib.records(w.now, None, usize::MAX);
                    let held = w.rib.revocations.claims(w.card.name().as_bytes());
                    assert!(
                        records.iter().filter(|r| r.name == w.card.name()).all(|r| r.verify(held, w.now.unix).is_ok())
                    );
                }
                11 => match also.take() {
                    Some(gone) if gone != *at => w.detach(identity, gone),
                    Some(_) => {}
                    None => {
                        *also = Some(random.below(SWITCHES));
                        also.map(|at| w.attach_lane(identity, 1, at));
                    }
                },
                12 => {
                    let role = if random.below(2) == 0 { writer } else { reader };
                    for at in [Some(*at), *also].into_iter().flatten() {
                        w.state_everywhere(identity, at, *serial, role);
                        *serial += 1;
                    }
                }
                _ if step % 4 == 0 => restart(&mut w, &entities, round * 100 + u64::from(step) + 2),
                _ if step % 4 < 3 => take_over(&mut w, &entities, round * 100 + u64::from(step) + 2),
                _ => {}
            }
            if random.below(3) == 0 {
                check(&mut w);
            }
        }
        check(&mut w);
        for Entity { identity, at, also, .. } in &entities {
            [Some(*at), *also].into_iter().flatten().for_each(|at| w.detach(identity, at));
        }
        w.settle();
        assert!(w.held.values().all(|held| held.routes.is_empty()), "names are left over");
        assert_eq!(w.rib.name_count(), 0);
    }
}

fn check(w: &mut World) {
    // What was lost comes again, after a while.
    let before = w.rib.timers.clone();
    w.tell_all();
    while let Some(retry) = w.rib.peer_updates.retry_at() {
        w.pass(retry.saturating_sub(w.now.clock).max(Duration::from_nanos(1)));
        w.tell_all();
    }
    assert_eq!(w.rib.timers, before, "nothing ended meanwhile");
    w.settle();
    w.check_model();
    w.check_delivery();
    w.check_record_limit();
}

/// Another RIB goes on with what this one has stored: it has the same to say, and nobody has to say
/// anything again.
fn take_over(w: &mut World, entities: &[Entity], id: u64) {
    w.store();
    let told = |w: &World| {
        let (mut records, _) = w.rib.records(w.now, None, usize::MAX);
        records.iter_mut().for_each(|record| record.expires_in = 0);
        let all = records.iter().map(|record| control::encode(record).unwrap()).collect::<Vec<_>>();
        let switches: Vec<_> = w.rib.switches().collect();
        let desired = switches.iter().map(|(switch, ..)| w.rib.desired(switch)).collect::<Vec<_>>();
        (all, switches, desired)
    };
    let before = told(w);
    // Later than all that is waited for here.
    let settling = w.now.clock + Duration::from_secs(24 * 3600);
    assert_eq!(w.take_over(RibRun { id, settling }), []);
    assert!(told(w) == before, "it has other things to say");
    for (item, bytes) in &w.stored {
        assert_eq!(w.rib.stored(w.now, item).as_ref(), Some(bytes), "{item}");
    }
    let unknown = w.rib.take_changed().into_iter().find(|item| !w.stored.contains_key(item));
    assert_eq!(unknown, None, "more than was stored");
    for i in 0..SWITCHES {
        w.report(i, &entities.iter().filter(|e| e.is_at(i)).map(|e| e.identity.name()).collect::<Vec<_>>());
    }
    assert!(w.rib.detached.is_empty(), "nobody has to attach again");
}

/// The RIB forgets everything; switches report, and entities attach again and state nothing until
/// they next do.
fn restart(w: &mut World, entities: &[Entity], id: u64) {
    w.rib = Rib::new(w.switch(0), RibRun { id, settling: Duration::ZERO }, Limits::default());
    w.rib.open_journal();
    w.stored.clear();
    (0..SWITCHES).for_each(|i| {
        let here: Vec<Name> = entities.iter().filter(|e| e.is_at(i)).map(|e| e.identity.name()).collect();
        w.report(i, &here);
    });
    let mut told: Vec<(Name, Name)> = w.detaches();
    let places = (0..SWITCHES).flat_map(|i| entities.iter().filter(move |e| e.is_at(i)).map(move |e| (i, e)));
    let mut expected: Vec<_> = places.map(|(i, e)| (w.switch(i), e.identity.name())).collect();
    told.sort();
    expected.sort();
    assert_eq!(told, expected, "whom the RIB does not know is to attach again");
    for Entity { identity, at, also, .. } in entities {
        w.attach(identity, *at);
        also.map(|at| w.attach_lane(identity, 1, at));
    }
    (0..SWITCHES).for_each(|i| {
        w.report(i, &entities.iter().filter(|e| e.is_at(i)).map(|e| e.identity.name()).collect::<Vec<_>>())
    });
}
