//! Under its own name every attached entity can be reached, by those it exchanges messages with and nobody else: who that is,
//! and which switches therefore need a route for it. One that is attached to several switches is reached at each of them. Pairs of
//! counterparts go in, routes come out.

use std::collections::{BTreeMap, HashMap, HashSet};

use gdp::control::{Refusal, Route};
use gdp_wire::Name;

use super::names::Key;
use super::{Limits, count_out, limit_reached};

/// An attached entity, and the switch it is attached to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place {
    pub entity: Name,
    pub switch: Name,
}

#[derive(Debug)]
struct Inbox {
    /// Its switches, and for how many pairs each.
    homes: BTreeMap<Name, u32>,
    /// By switch: those who may send here, and for how many names and roles.
    senders: BTreeMap<Name, BTreeMap<Name, u32>>,
}

impl Inbox {
    /// Whether the entity may send here, from wherever.
    fn takes_from(&self, sender: &Name) -> bool {
        self.senders.values().any(|here| here.contains_key(sender))
    }
}

#[derive(Debug, Default)]
pub(super) struct Inboxes {
    inboxes: BTreeMap<Key, Inbox>,
    /// Into how many inboxes each entity may send; it can be reached from as many.
    reaches: HashMap<Name, usize>,
    /// The same at each switch, of the entities there: pairs of an inbox and a sender.
    reached_from: HashMap<Name, usize>,
}

impl Inboxes {
    /// Whether `new` may have these counterparts besides those it has: whether there is room for what [`Self::allow`] adds.
    pub fn check_room(&self, new: Place, others: &[Place], limits: &Limits) -> Result<(), Refusal> {
        let limit = limits.counterparts;
        let is_full = |entity: &Name, more: usize| self.reaches.get(entity).copied().unwrap_or_default() + more > limit;
        let full = |entity: &Name| Err(limit_reached(format!("{entity} exchanges messages with {limit} entities")));
        let (mut met, mut entered) = (HashSet::new(), HashSet::new());
        let mut more: HashMap<Name, usize> = HashMap::new();
        for other in others.iter().filter(|other| other.entity != new.entity) {
            if !self.allows(new.entity, *other) {
                *more.entry(other.switch).or_default() += 1;
            }
            if !self.allows(other.entity, new) && entered.insert(other.entity) {
                *more.entry(new.switch).or_default() += 1;
            }
            let knows = self.inboxes.get(new.entity.as_bytes()).is_some_and(|inbox| inbox.takes_from(&other.entity));
            if !knows && met.insert(other.entity) && is_full(&other.entity, 1) {
                return full(&other.entity);
            }
        }
        if !met.is_empty() && is_full(&new.entity, met.len()) {
            return full(&new.entity);
        }
        let limit = limits.counterparts_per_switch;
        let lacks =
            |switch: &Name, more: usize| self.reached_from.get(switch).copied().unwrap_or_default() + more > limit;
        match more.into_iter().find(|(switch, more)| lacks(switch, *more)) {
            Some((switch, _)) => {
                Err(limit_reached(format!("the entities at switch {switch} have {limit} counterparts")))
            }
            None => Ok(()),
        }
    }

    /// Lets `sender` send to `inbox`, for one more reason. Returns the switches whose route for it may change.
    pub fn allow(&mut self, inbox: Place, sender: Place) -> Vec<Name> {
        let new = || Inbox { homes: BTreeMap::new(), senders: BTreeMap::new() };
        let held = self.inboxes.entry(inbox.entity.to_bytes()).or_insert_with(new);
        if !held.takes_from(&sender.entity) {
            *self.reaches.entry(sender.entity).or_default() += 1;
        }
        *held.homes.entry(inbox.switch).or_default() += 1;
        let reasons = held.senders.entry(sender.switch).or_default().entry(sender.entity).or_default();
        *reasons += 1;
        if *reasons == 1 {
            *self.reached_from.entry(sender.switch).or_default() += 1;
        }
        self.affected(inbox, sender)
    }

    /// One reason less. Returns the switches whose route may change, and whether `sender` may no longer send from anywhere.
    pub fn deny(&mut self, inbox: Place, sender: Place) -> (Vec<Name>, bool) {
        let before = self.affected(inbox, sender);
        if !self.remove(inbox, sender) {
            return (before, false);
        }
        count_out(&mut self.reached_from, &sender.switch, 1);
        let held = self.inboxes.get(inbox.entity.as_bytes());
        let ended = !held.is_some_and(|inbox| inbox.takes_from(&sender.entity));
        if ended {
            count_out(&mut self.reaches, &sender.entity, 1);
        }
        (before, ended)
    }

    /// Where the inbox comes or goes: with another switch of its own, the routes of all that send there change.
    fn affected(&self, inbox: Place, sender: Place) -> Vec<Name> {
        let held = self.inboxes.get(inbox.entity.as_bytes());
        let only_one = held.is_some_and(|held| held.homes.len() > 1 && held.homes.get(&inbox.switch) == Some(&1));
        let senders = held.filter(|_| only_one).into_iter().flat_map(|held| held.senders.keys().copied());
        senders.chain([inbox.switch, sender.switch]).collect()
    }

    fn remove(&mut self, inbox: Place, sender: Place) -> bool {
        let key = inbox.entity.to_bytes();
        let Some(held) = self.inboxes.get_mut(&key) else { return false };
        if let Some(reasons) = held.homes.get_mut(&inbox.switch) {
            *reasons -= 1;
            if *reasons == 0 {
                held.homes.remove(&inbox.switch);
            }
        }
        let Some(here) = held.senders.get_mut(&sender.switch) else { return false };
        let Some(reasons) = here.get_mut(&sender.entity) else { return false };
        *reasons -= 1;
        if *reasons > 0 {
            return false;
        }
        here.remove(&sender.entity);
        if here.is_empty() {
            held.senders.remove(&sender.switch);
        }
        if held.senders.is_empty() {
            self.inboxes.remove(&key);
        }
        true
    }

    /// Whether the entity may send to that inbox.
    pub fn allows(&self, inbox: Name, sender: Place) -> bool {
        let here = self.inboxes.get(inbox.as_bytes()).and_then(|inbox| inbox.senders.get(&sender.switch));
        here.is_some_and(|here| here.contains_key(&sender.entity))
    }

    /// Switches that a route for this inbox is for; some twice.
    pub fn routed(&self, inbox: &Name) -> impl Iterator<Item = &Name> {
        let held = self.inboxes.get(inbox.as_bytes());
        held.into_iter().flat_map(|inbox| inbox.senders.keys().chain(inbox.homes.keys()))
    }

    /// The route for an inbox at one switch, if it needs any.
    pub fn route(&self, inbox: &Key, switch: &Name, bit: impl Fn(&Name) -> Option<u8>) -> Option<Route> {
        let held = self.inboxes.get(inbox)?;
        let name = Name::from_bytes(*inbox);
        let writers: Vec<Name> = held.senders.get(switch).into_iter().flat_map(|here| here.keys().copied()).collect();
        let locals = if held.homes.contains_key(switch) { vec![name] } else { Vec::new() };
        if writers.is_empty() && locals.is_empty() {
            return None;
        }
        let homes = held.homes.keys().filter_map(bit).fold(0, |bits, bit| bits | 1 << bit);
        let egress_bits = if writers.is_empty() { 0 } else { homes };
        Some(Route { name, egress_bits, everywhere: locals.clone(), locals, writers })
    }
}
