//! Computes the routes to inboxes. An attached entity's inbox is its own name. Only its
//! counterparts, the entities that it exchanges messages with, can reach it. An entity attached to
//! several switches is reached at each of them. Pairs of counterparts go in, routes come out.
//!
//! An entity of another domain that has a counterpart is reached by the border toward its domain.
//! Its frames may arrive by any link that leads there.

use crate::rib::model::InboxOwner;
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

use gdp_proto::control::{Refusal, Route};
use gdp_wire::Name;

use super::border_links::Map;
use crate::rib::model::{At, Limits, NameBytes, count_out, limit_reached};

#[derive(Debug)]
struct Inbox {
    /// Locations of the owner, each with the number of pairs that need it.
    homes: BTreeMap<At, u32>,
    /// Entities that may send to the inbox, by location, with the number of names and roles that
    /// allow it.
    senders: BTreeMap<At, BTreeMap<Name, u32>>,
}

impl Inbox {
    /// Returns whether the entity may send to this inbox from any location.
    fn takes_from(&self, sender: &Name) -> bool {
        self.senders.values().any(|here| here.contains_key(sender))
    }
}

#[derive(Debug, Default)]
pub(super) struct Inboxes {
    inboxes: BTreeMap<NameBytes, Inbox>,
    /// Number of inboxes that each entity may send to. As many entities can reach its own inbox.
    reaches: HashMap<Name, usize>,
    /// Number of pairs (inbox, sender) by the location of the sender.
    reached_from: HashMap<At, usize>,
}

impl Inboxes {
    /// Checks that the limits have room for what [`Self::allow`] adds when `new` meets `others`.
    pub fn check_room(&self, new: InboxOwner, others: &[InboxOwner], limits: &Limits) -> Result<(), Refusal> {
        let limit = limits.counterparts;
        let is_full = |entity: &Name, more: usize| self.reaches.get(entity).copied().unwrap_or_default() + more > limit;
        let full = |entity: &Name| Err(limit_reached(format!("{entity} exchanges messages with {limit} entities")));
        let (mut met, mut entered) = (HashSet::new(), HashSet::new());
        let mut more: HashMap<At, usize> = HashMap::new();
        for other in others.iter().filter(|other| other.entity != new.entity) {
            if !self.allows(new.entity, *other) {
                *more.entry(other.at).or_default() += 1;
            }
            if !self.allows(other.entity, new) && entered.insert(other.entity) {
                *more.entry(new.at).or_default() += 1;
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
        let lacks = |at: &At, more: usize| self.reached_from.get(at).copied().unwrap_or_default() + more > limit;
        match more.into_iter().find(|(at, more)| lacks(at, *more)) {
            Some((At::Here(switch), _)) => {
                Err(limit_reached(format!("the entities at switch {switch} have {limit} counterparts")))
            }
            Some((At::RemoteRegistrations(realm), _)) => {
                Err(limit_reached(format!("the entities of domain {} have {limit} counterparts", realm.domain)))
            }
            None => Ok(()),
        }
    }

    /// Adds one reason for `sender` to send to `inbox`. Returns the locations where its route may
    /// change.
    pub fn allow(&mut self, inbox: InboxOwner, sender: InboxOwner) -> Vec<At> {
        let new = || Inbox { homes: BTreeMap::new(), senders: BTreeMap::new() };
        let held = self.inboxes.entry(inbox.entity.to_bytes()).or_insert_with(new);
        if !held.takes_from(&sender.entity) {
            *self.reaches.entry(sender.entity).or_default() += 1;
        }
        *held.homes.entry(inbox.at).or_default() += 1;
        let reasons = held.senders.entry(sender.at).or_default().entry(sender.entity).or_default();
        *reasons += 1;
        if *reasons == 1 {
            *self.reached_from.entry(sender.at).or_default() += 1;
        }
        self.affected(inbox, sender)
    }

    /// Removes one reason for `sender` to send to `inbox`.
    ///
    /// Returns the locations where the route may change, and whether `sender` can no longer send
    /// from any location.
    pub fn deny(&mut self, inbox: InboxOwner, sender: InboxOwner) -> (Vec<At>, bool) {
        let before = self.affected(inbox, sender);
        if !self.remove(inbox, sender) {
            return (before, false);
        }
        count_out(&mut self.reached_from, &sender.at, 1);
        let held = self.inboxes.get(inbox.entity.as_bytes());
        let ended = !held.is_some_and(|inbox| inbox.takes_from(&sender.entity));
        if ended {
            count_out(&mut self.reaches, &sender.entity, 1);
        }
        (before, ended)
    }

    /// Returns the locations whose routes change when the inbox appears or disappears. A further
    /// home of the inbox changes the routes at all its senders.
    fn affected(&self, inbox: InboxOwner, sender: InboxOwner) -> Vec<At> {
        let held = self.inboxes.get(inbox.entity.as_bytes());
        let only_one = held.is_some_and(|held| held.homes.len() > 1 && held.homes.get(&inbox.at) == Some(&1));
        let senders = held.filter(|_| only_one).into_iter().flat_map(|held| held.senders.keys().copied());
        senders.chain([inbox.at, sender.at]).collect()
    }

    fn remove(&mut self, inbox: InboxOwner, sender: InboxOwner) -> bool {
        let key = inbox.entity.to_bytes();
        let Some(held) = self.inboxes.get_mut(&key) else { return false };
        if let Some(reasons) = held.homes.get_mut(&inbox.at) {
            *reasons -= 1;
            if *reasons == 0 {
                held.homes.remove(&inbox.at);
            }
        }
        let Some(here) = held.senders.get_mut(&sender.at) else { return false };
        let Some(reasons) = here.get_mut(&sender.entity) else { return false };
        *reasons -= 1;
        if *reasons > 0 {
            return false;
        }
        here.remove(&sender.entity);
        if here.is_empty() {
            held.senders.remove(&sender.at);
        }
        if held.senders.is_empty() {
            self.inboxes.remove(&key);
        }
        true
    }

    /// Returns whether the entity may send to the inbox from its location.
    pub fn allows(&self, inbox: Name, sender: InboxOwner) -> bool {
        let here = self.inboxes.get(inbox.as_bytes()).and_then(|inbox| inbox.senders.get(&sender.at));
        here.is_some_and(|here| here.contains_key(&sender.entity))
    }

    /// Returns the switches that need a route for this inbox.
    pub fn routed(&self, inbox: &Name, map: Map) -> BTreeSet<Name> {
        let held = self.inboxes.get(inbox.as_bytes()).into_iter();
        held.flat_map(|inbox| inbox.senders.keys().chain(inbox.homes.keys())).flat_map(|at| map.switches(at)).collect()
    }

    /// Returns the route for an inbox at one switch, if the switch needs one.
    pub fn route(&self, inbox: &NameBytes, switch: &Name, map: Map) -> Option<Route> {
        let held = self.inboxes.get(inbox)?;
        let name = Name::from_bytes(*inbox);
        let (mut writers, mut egress_bits) = (BTreeSet::new(), 0);
        for (at, senders) in &held.senders {
            let links: Vec<Name> = match at {
                At::Here(here) if here == switch => senders.keys().copied().collect(),
                At::Here(_) => Vec::new(),
                At::RemoteRegistrations(realm) => map.arrives_from(realm, switch).collect(),
            };
            if !links.is_empty() {
                writers.extend(links);
                let homes = held.homes.keys().filter(|home| !is_one_domain(at, home));
                egress_bits |= homes.fold(0, |bits, home| bits | map.bits_to(inbox, home));
            }
        }
        let everywhere: Vec<Name> = held.homes.contains_key(&At::Here(*switch)).then_some(name).into_iter().collect();
        let to_abroad = held.homes.keys().filter_map(|home| match home {
            At::Here(_) => None,
            At::RemoteRegistrations(realm) => map.leaves_to(inbox, realm, switch),
        });
        let locals: BTreeSet<Name> = everywhere.iter().copied().chain(to_abroad).collect();
        let arrives_by = self.arrives_by(inbox, switch, map);
        if writers.is_empty() && locals.is_empty() && arrives_by.is_empty() {
            return None;
        }
        let (locals, writers) = (locals.into_iter().collect(), writers.into_iter().collect());
        Some(Route { name, egress_bits, locals, everywhere, writers, arrives_by })
    }

    /// Returns the peers from which frames of an entity of another domain arrive at this border.
    pub fn arrives_by(&self, entity: &NameBytes, border: &Name, map: Map) -> Vec<Name> {
        let homes = self.inboxes.get(entity).into_iter().flat_map(|held| held.homes.keys());
        let from = homes.flat_map(|home| match home {
            At::Here(_) => Vec::new(),
            At::RemoteRegistrations(realm) => map.arrives_from(realm, border).collect(),
        });
        from.collect::<BTreeSet<_>>().into_iter().collect()
    }
}

/// Returns whether both locations are in the same other domain.
fn is_one_domain(one: &At, other: &At) -> bool {
    matches!((one, other), (At::RemoteRegistrations(one), At::RemoteRegistrations(other)) if one.domain == other.domain)
}
