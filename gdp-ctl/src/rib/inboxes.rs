//! Under its own name every attached entity can be reached, by those it exchanges messages with and nobody else: who that is,
//! and which switches therefore need a route for it. Pairs of counterparts go in, routes come out.

use std::collections::{BTreeMap, HashMap};

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
    home: Name,
    /// By switch: those who may send here, and for how many names and roles.
    senders: BTreeMap<Name, BTreeMap<Name, u32>>,
}

#[derive(Debug, Default)]
pub(super) struct Inboxes {
    inboxes: BTreeMap<Key, Inbox>,
    /// Into how many inboxes each entity may send; it can be reached from as many.
    reaches: HashMap<Name, usize>,
    /// The same for all entities at a switch.
    reached_from: HashMap<Name, usize>,
}

impl Inboxes {
    /// Whether `new` may have these counterparts besides those it has.
    pub fn check_room(&self, new: Place, others: &[Place], limits: &Limits) -> Result<(), Refusal> {
        let limit = limits.counterparts;
        let full = |entity: &Name| limit_reached(format!("{entity} exchanges messages with {limit} entities"));
        let mut more: HashMap<Name, usize> = HashMap::new();
        for other in others.iter().filter(|other| other.entity != new.entity && !self.allows(new.entity, **other)) {
            if self.reaches.get(&other.entity).is_some_and(|count| *count >= limit) {
                return Err(full(&other.entity));
            }
            *more.entry(other.switch).or_default() += 1;
        }
        let count: usize = more.values().sum();
        if self.reaches.get(&new.entity).copied().unwrap_or_default() + count > limit {
            return Err(full(&new.entity));
        }
        *more.entry(new.switch).or_default() += count;
        let limit = limits.counterparts_per_switch;
        match more
            .iter()
            .find(|(switch, more)| self.reached_from.get(*switch).copied().unwrap_or_default() + **more > limit)
        {
            Some((switch, _)) => {
                Err(limit_reached(format!("the entities at switch {switch} have {limit} counterparts")))
            }
            None => Ok(()),
        }
    }

    /// Lets `sender` send to `inbox`, for one more reason. Returns the switches whose route for it may change.
    pub fn allow(&mut self, inbox: Place, sender: Place) -> [Name; 2] {
        let new = || Inbox { home: inbox.switch, senders: BTreeMap::new() };
        let senders = &mut self.inboxes.entry(inbox.entity.to_bytes()).or_insert_with(new).senders;
        let reasons = senders.entry(sender.switch).or_default().entry(sender.entity).or_default();
        *reasons += 1;
        if *reasons == 1 {
            *self.reaches.entry(sender.entity).or_default() += 1;
            *self.reached_from.entry(sender.switch).or_default() += 1;
        }
        [inbox.switch, sender.switch]
    }

    /// One reason less. Returns the switches whose route may change, and whether `sender` may no longer send.
    pub fn deny(&mut self, inbox: Place, sender: Place) -> ([Name; 2], bool) {
        let ended = self.remove(inbox, sender);
        if ended {
            count_out(&mut self.reaches, &sender.entity, 1);
            count_out(&mut self.reached_from, &sender.switch, 1);
        }
        ([inbox.switch, sender.switch], ended)
    }

    fn remove(&mut self, inbox: Place, sender: Place) -> bool {
        let key = inbox.entity.to_bytes();
        let Some(held) = self.inboxes.get_mut(&key) else { return false };
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
        held.into_iter().flat_map(|inbox| inbox.senders.keys().chain([&inbox.home]))
    }

    /// The route for an inbox at one switch, if it needs any.
    pub fn route(&self, inbox: &Key, switch: &Name, bit: impl Fn(&Name) -> Option<u8>) -> Option<Route> {
        let held = self.inboxes.get(inbox)?;
        let name = Name::from_bytes(*inbox);
        let writers: Vec<Name> = held.senders.get(switch).into_iter().flat_map(|here| here.keys().copied()).collect();
        let locals = if held.home == *switch { vec![name] } else { Vec::new() };
        if writers.is_empty() && locals.is_empty() {
            return None;
        }
        let egress_bits = if writers.is_empty() { 0 } else { bit(&held.home).map_or(0, |bit| 1 << bit) };
        Some(Route { name, egress_bits, locals, writers })
    }
}
