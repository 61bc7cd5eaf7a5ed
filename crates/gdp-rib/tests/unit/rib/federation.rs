//! Several domains, each with its RIB, and borders between them. RIBs tell each other what they
//! have to, as if there were no time and no loss between them; and frames go through the FIBs of
//! all as `gdp_wire::forward` would have them.

use std::collections::{BTreeMap, BTreeSet};

use gdp_core::name::Name;
use gdp_proto::control::{Credential, NameRole, Record, RecordKey, Refusal, RefusalCode};

use super::world::World;
use crate::rib::model::RegistrationKey;
use crate::rib::{BorderLink, Foreign, Limits, Rib, RibRun};

pub struct Federation {
    pub domains: Vec<World>,
    /// Which RIBs tell each other. No circles: it is for the caller of the RIB to break those.
    pub neighbours: Vec<(usize, usize)>,
    pub borders: Vec<Border>,
    /// Who lets whom cross.
    pub transit: Vec<(usize, usize)>,
}

/// A link between switches of two domains, with what each says that it costs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Border(pub [(usize, usize); 2], pub [u32; 2]);

/// What became of a frame.
#[derive(Debug, Default)]
pub struct Sent {
    /// Who got a copy, by domain.
    pub delivered: Vec<(usize, Name)>,
    /// Copies that a switch of this domain did not take: it was not allowed to come there.
    pub refused: Vec<usize>,
    /// Copies that were not to leave for a third domain.
    pub stopped: usize,
}

struct Copy {
    domain: usize,
    at: Name,
    bits: u64,
    is_foreign: bool,
    /// Where it came in.
    border: Option<(Name, Name)>,
}

impl Federation {
    pub fn new(sizes: &[usize], neighbours: &[(usize, usize)], borders: &[Border]) -> Self {
        let mut domains: Vec<World> = sizes.iter().map(|size| World::chain(*size)).collect();
        let (owner, card) = (domains[0].owner.clone(), domains[0].card.clone());
        domains.iter_mut().for_each(|w| (w.owner, w.card) = (owner.clone(), card.clone()));
        let mut f = Self { domains, neighbours: neighbours.to_vec(), borders: borders.to_vec(), transit: vec![] };
        f.set_scope(&(0..sizes.len()).collect::<Vec<_>>());
        f.set_ways();
        f
    }

    /// Of what is stated from now on.
    pub fn set_scope(&mut self, domains: &[usize]) {
        self.domains.iter_mut().for_each(|w| w.scope = domains.iter().copied().map(domain).collect());
    }

    /// The borders are now others.
    pub fn set_ways(&mut self) {
        for i in 0..self.domains.len() {
            let ways = self.ways(i);
            let now = self.domains[i].now;
            self.domains[i].rib.set_ways(now, ways);
        }
    }

    pub fn ways(&self, of: usize) -> BTreeMap<Name, Vec<BorderLink>> {
        let mut ways = BTreeMap::<Name, Vec<BorderLink>>::new();
        for Border(ends, costs) in &self.borders {
            for (own, other) in [(0, 1), (1, 0)].into_iter().filter(|(own, _)| ends[*own].0 == of) {
                let [border, peer] = [own, other].map(|end| self.switch(ends[end]));
                ways.entry(domain(ends[other].0)).or_default().push(BorderLink { border, peer, cost: costs[own] });
            }
        }
        ways
    }

    pub fn switch(&self, (domain, index): (usize, usize)) -> Name {
        self.domains[domain].switch(index)
    }

    /// Has RIBs tell each other, their switches and their entities until there is nothing left to
    /// tell.
    pub fn settle(&mut self) {
        loop {
            let mut told = 0;
            for from in 0..self.domains.len() {
                for place in self.domains[from].rib.take_changed_keys() {
                    let to = self.neighbours.iter().filter_map(|(a, b)| match from {
                        i if i == *a => Some(*b),
                        i if i == *b => Some(*a),
                        _ => None,
                    });
                    for to in to.collect::<Vec<_>>() {
                        told += 1;
                        self.tell(from, to, &place);
                    }
                }
            }
            told += self.domains.iter_mut().map(World::tell_all).sum::<usize>();
            if told == 0 {
                break;
            }
        }
        self.domains.iter_mut().for_each(World::settle);
    }

    fn tell(&mut self, from: usize, to: usize, place: &RecordKey) {
        let (next, other) = (domain(from), domain(to));
        let export = self.domains[from].rib.export(self.domains[from].now, place);
        let export = export.filter(|export| export.origin.is_none_or(|(origin, via)| origin != other && via != other));
        let now = self.domains[to].now;
        let rib = &mut self.domains[to].rib;
        match export {
            Some(export) => {
                let local = scope(&export.record).is_none_or(|scope| scope.contains(&other));
                let (domain, hops) = export.origin.map_or((next, 1), |(domain, _)| (domain, 2));
                let foreign = Foreign { record: export.record, domain, next, hops, boxes: export.boxes, local };
                let taken = rib.set_foreign(now, foreign);
                // It is where it was told of before, and has said something newer there.
                let is_behind = |refusal: &Refusal| refusal.code == RefusalCode::ReplayedSerial;
                assert!(taken.as_ref().err().is_none_or(is_behind), "{taken:?}");
            }
            None => rib.remove_foreign(now, place, &next),
        }
    }

    /// What becomes of a frame of an entity at a switch.
    pub fn send(&self, (at_domain, at): (usize, Name), source: Name, name: Name) -> Sent {
        let mut sent = Sent::default();
        let route = self.domains[at_domain].held[&at].routes.get(&name);
        let Some(route) = route.filter(|route| route.writers.contains(&source)) else {
            sent.refused.push(at_domain);
            return sent;
        };
        let mut copies = vec![Copy { domain: at_domain, at, bits: route.egress_bits, is_foreign: false, border: None }];
        for _ in 0..32 {
            for copy in std::mem::take(&mut copies) {
                self.forward(copy, source, name, &mut sent, &mut copies);
            }
        }
        assert!(copies.is_empty(), "a loop");
        sent
    }

    fn forward(&self, copy: Copy, source: Name, name: Name, sent: &mut Sent, copies: &mut Vec<Copy>) {
        let Copy { domain, at, bits, .. } = copy;
        let w = &self.domains[domain];
        let held = &w.held[&at];
        if bits & 1 << held.own_bit != 0 {
            let locals = held.routes.get(&name).map_or(&[][..], |route| &route.locals);
            for local in locals {
                let Some((to, _)) = self.record_key_of(local) else {
                    sent.delivered.push((domain, *local));
                    continue;
                };
                if copy.border == Some((at, *local)) {
                    continue;
                }
                if copy.is_foreign {
                    sent.stopped += 1;
                    continue;
                }
                let routes = &self.domains[to].held[local].routes;
                let route = routes.get(&name).filter(|route| route.writers.contains(&at));
                let comes = routes.get(&source).is_some_and(|route| route.arrives_by.contains(&at));
                match route.filter(|_| comes) {
                    Some(route) => copies.push(Copy {
                        domain: to,
                        at: *local,
                        bits: route.egress_bits,
                        is_foreign: !self.transit.contains(&(to, domain)),
                        border: Some((*local, at)),
                    }),
                    None => sent.refused.push(to),
                }
            }
        }
        let index = w.switches.iter().position(|switch| switch.name() == at).unwrap();
        let onward = w.paths(index).reach.into_iter().map(|(next, reach)| (next, bits & reach & !(1 << held.own_bit)));
        copies.extend(onward.filter(|(_, bits)| *bits != 0).map(|(next, bits)| Copy { at: next, bits, ..copy }));
    }

    /// Where a switch is, if it is one.
    fn record_key_of(&self, switch: &Name) -> Option<(usize, usize)> {
        let places = self.domains.iter().enumerate().flat_map(|(d, w)| (0..w.switches.len()).map(move |i| (d, i)));
        places.into_iter().find(|place| self.switch(*place) == *switch)
    }

    /// What is registered in each domain itself.
    pub fn records(&self) -> Vec<(usize, Record)> {
        let all = self.domains.iter().enumerate().flat_map(|(d, w)| {
            let (records, _) = w.rib.records(w.now, None, usize::MAX);
            let here = records.into_iter().filter(|record| w.rib.bit(&record.switch).is_some());
            here.map(move |record| (d, record)).collect::<Vec<_>>()
        });
        all.collect()
    }

    /// Sends a frame of everybody that may send: those who take it, in whichever domain, get one
    /// copy, and nobody else any. And everybody knows just those.
    pub fn check_delivery(&self) {
        let records = self.records();
        let entity = |record: &Record| record.entity.name().unwrap();
        for (d, record) in &records {
            let (role, own) = (record.role().unwrap(), entity(record));
            let is_counterpart =
                |(_, r): &&(usize, Record)| r.name == record.name && r.role().unwrap() == role.counterpart();
            let met = records.iter().filter(is_counterpart).filter(|(to, r)| meet((*d, record), (*to, r)));
            let met: Vec<_> = met.collect();
            let known = &self.domains[*d].nodes[&(own, record.name, role)];
            let known: BTreeSet<Name> = known.known().map(|known| known.entity).collect();
            assert_eq!(known, met.iter().map(|(_, r)| entity(r)).collect(), "in domain {d}");
            if role == NameRole::Publisher && !met.is_empty() {
                let sent = self.send((*d, record.switch), own, record.name);
                let mut delivered = sent.delivered.clone();
                delivered.sort();
                let mut expected: Vec<_> = met.iter().map(|(to, r)| (*to, entity(r))).collect();
                expected.sort();
                assert_eq!(delivered, expected, "{sent:?} of domain {d}");
                // Copies go where anybody at a switch sends to; those that are for others do not
                // come in.
                let is_for_others = |to: &usize| to == d || met.iter().all(|(met, _)| met != to);
                assert!(sent.refused.iter().all(is_for_others), "{sent:?} of domain {d}");
            }
            for (to, other) in met.iter().filter(|(_, other)| entity(other) != own) {
                let sent = self.send((*d, record.switch), own, entity(other));
                assert_eq!(sent.delivered, [(*to, entity(other))], "{sent:?} from domain {d}");
                assert!(sent.refused.is_empty(), "{sent:?} of domain {d}");
            }
        }
    }

    /// Each RIB wants the same as one that came to know all of it at once.
    pub fn check_anew(&self) {
        for w in &self.domains {
            let mut anew = Rib::new(w.switch(0), RibRun { id: 1, settling: Default::default() }, Limits::default());
            for switch in &w.switches {
                anew.report(w.now, &switch.proof(), &[], w.rib.bit(&switch.name()));
            }
            anew.ways = w.rib.ways.clone();
            for place in w.rib.names.all_keys() {
                let (record, registration) = w.rib.names.record_at(w.now.clock, &place).unwrap();
                let (entity, role) = (place.entity, place.role);
                let registration_key = RegistrationKey { name: place.name.to_bytes(), entity, role };
                anew.store(registration_key, record.proof, registration.clone()).unwrap();
            }
            for switch in &w.switches {
                assert_eq!(w.rib.desired(&switch.name()), anew.desired(&switch.name()));
            }
        }
    }

    /// Nothing is left of anybody.
    pub fn check_empty(&self) {
        for w in &self.domains {
            assert_eq!(w.rib.name_count(), 0);
            assert!(w.held.values().all(|held| held.routes.is_empty()), "names are left over");
        }
    }

    pub fn pass(&mut self, time: std::time::Duration) {
        self.domains.iter_mut().for_each(|w| w.pass(time));
    }
}

/// Whether two counterparts may exchange messages: within one domain, or as far as the writer's
/// scope goes.
fn meet(one: (usize, &Record), other: (usize, &Record)) -> bool {
    let (writer, reader) = if one.1.is_writer() { (one, other) } else { (other, one) };
    one.0 == other.0 || scope(writer.1).is_some_and(|scope| scope.contains(&domain(reader.0)))
}

/// Of a writer.
fn scope(record: &Record) -> Option<Vec<Name>> {
    match &record.credential {
        Credential::Writer(cert) => Some(cert.cert.claims_unverified().unwrap().scope),
        Credential::Reader(_) => None,
    }
}

pub fn domain(index: usize) -> Name {
    Name::from_bytes([0xd0 + index as u8; 32])
}

/// Roles that may meet in a name of this number.
pub fn roles(name: usize) -> [NameRole; 2] {
    if name.is_multiple_of(2) {
        [NameRole::Publisher, NameRole::Subscriber]
    } else {
        [NameRole::Server, NameRole::Caller]
    }
}
