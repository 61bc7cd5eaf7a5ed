//! The verified servers or callers of a service, and the selection of a server.
//!
//! Updates of the RIB are inputs, the affected entities are outputs. No I/O.

use std::cmp::Ordering;
use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;
use std::sync::atomic::{self, AtomicUsize};

use gdp_wire::Name;
use tokio::sync::watch;

use gdp_core::cert::Revocation;
use gdp_core::crypto;
use gdp_proto::peers::{Counterpart, PeerEvent};

/// Time for which a detached party and its outstanding calls are retained, because links return. In
/// nanoseconds.
const ABSENCE: u64 = 60_000_000_000;

/// Maximum number of detached parties. Beyond it, the one with the longest absence is removed.
const MOST_ABSENT: usize = 64;

/// Maximum number of known parties per service. A key is stored for each (`keys::MAX_WRITERS`).
const MAX_PARTIES: usize = 1024;

/// A server of a service, as seen by a caller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Instance {
    pub name: Name,
    /// The cost of the path to the server's switch, if the caller's switch knows it. It knows no
    /// costs of other domains.
    pub cost: Option<u64>,
    /// Number of this node's outstanding calls to the server for the service.
    pub waiting: usize,
    tie: [u8; 32],
}

impl Instance {
    /// Orders servers by path cost, then by outstanding calls. Ties are resolved by a hash of
    /// caller and server, which distributes callers.
    fn order(&self, other: &Self) -> Ordering {
        let rank = |one: &Self| (one.cost.unwrap_or(u64::MAX), one.waiting, one.tie);
        rank(self).cmp(&rank(other))
    }
}

/// The outstanding calls to one server while it is attached.
#[derive(Debug)]
struct Presence {
    calls: AtomicUsize,
    left: watch::Sender<bool>,
}

/// An outstanding call at a server. Dropping it ends the call.
#[derive(Debug)]
pub struct PendingCall {
    pub instance: Name,
    presence: Arc<Presence>,
}

impl PendingCall {
    /// Returns once the server is detached.
    pub async fn left(&self) {
        // `self.presence` contains the sender, so the wait does not fail.
        let _ = self.presence.left.subscribe().wait_for(|left| *left).await;
    }

    pub fn has_left(&self) -> bool {
        *self.presence.left.borrow()
    }
}

impl Drop for PendingCall {
    fn drop(&mut self) {
        self.presence.calls.fetch_sub(1, atomic::Ordering::Relaxed);
    }
}

struct ServiceInstance {
    right: Counterpart,
    /// The time of the right's announcement.
    stated_at: u64,
    /// Present while the party is attached.
    presence: Option<Arc<Presence>>,
    absent_since: u64,
    tie: [u8; 32],
}

impl ServiceInstance {
    /// Marks the party as detached. Returns whether it was attached.
    fn leave(&mut self, now: u64) -> bool {
        let Some(presence) = self.presence.take() else { return false };
        presence.left.send_replace(true);
        self.absent_since = now;
        true
    }
}

/// The parties on the other side of one service.
pub struct ServiceInstances {
    own: Name,
    known: HashMap<Name, ServiceInstance>,
    revocation: Option<Revocation>,
    /// Notified when the set of attached parties changes.
    changed: watch::Sender<()>,
}

impl ServiceInstances {
    /// Creates an empty set for the entity `own`.
    pub fn new(own: Name) -> Self {
        Self { own, known: HashMap::new(), revocation: None, changed: watch::Sender::new(()) }
    }

    /// Returns a receiver that is notified of each attached or detached party. It ends with this
    /// set.
    pub fn changes(&self) -> watch::Receiver<()> {
        self.changed.subscribe()
    }

    /// Processes the RIB's verified updates about the `service` at `now` (steady clock,
    /// nanoseconds). Returns the affected entities.
    pub fn take(&mut self, now: u64, service: &Name, events: &[PeerEvent]) -> BTreeSet<Name> {
        let mut concerned = BTreeSet::new();
        for event in events {
            match event {
                // The node does not call itself.
                PeerEvent::Joined(right) if right.entity == self.own => {}
                PeerEvent::Joined(right) if self.has_room(&right.entity) => {
                    concerned.insert(right.entity);
                    self.join(now, right.clone());
                }
                PeerEvent::Joined(right) => {
                    tracing::warn!(%service, party = %right.entity, "more than {MAX_PARTIES} entities on the other side; this one is left out");
                }
                PeerEvent::Left(entity) => {
                    if self.known.get_mut(entity).is_some_and(|party| party.leave(now)) {
                        self.changed.send_replace(());
                    }
                }
                PeerEvent::Expelled(entity) => {
                    self.known.get_mut(entity).into_iter().for_each(|party| party.right.not_after = 0);
                }
                PeerEvent::Revoked(revocation) => self.revocation = Some(revocation.clone()),
                PeerEvent::Refused(error) => {
                    tracing::warn!(%service, %error, "the RIB told of one that does not verify");
                }
                // The service's name carries no messages and needs no keys. The supervisor handles
                // a RIB that lacks a revocation.
                PeerEvent::KeyBox(_) | PeerEvent::RibIsBehind(_) => {}
            }
        }
        concerned
    }

    fn has_room(&self, entity: &Name) -> bool {
        self.known.len() < MAX_PARTIES || self.known.contains_key(entity)
    }

    fn join(&mut self, stated_at: u64, right: Counterpart) {
        let (own, entity) = (self.own, right.entity);
        let new = || ServiceInstance {
            right: right.clone(),
            stated_at,
            presence: None,
            absent_since: 0,
            tie: crypto::sha256(&[own.as_bytes(), entity.as_bytes()]),
        };
        let party = self.known.entry(entity).or_insert_with(new);
        if party.presence.is_none() {
            party.presence = Some(Presence { calls: AtomicUsize::new(0), left: watch::Sender::new(false) }.into());
            self.changed.send_replace(());
        }
        (party.right, party.stated_at) = (right, stated_at);
    }

    /// Removes the parties that are absent for too long, or whose right has expired by `now_unix`
    /// (seconds) or was revoked. Returns them.
    pub fn sweep(&mut self, now: u64, now_unix: u64) -> BTreeSet<Name> {
        let revocation = self.revocation.as_ref();
        let holds = |right: &Counterpart| {
            right.not_after >= now_unix && revocation.is_none_or(|revocation| right.holds(revocation))
        };
        let mut away: Vec<_> = self.known.iter().filter(|(_, party)| party.presence.is_none()).collect();
        away.sort_unstable_by_key(|(name, party)| (party.absent_since, **name));
        let too_many = away.len().saturating_sub(MOST_ABSENT);
        let long = away.iter().filter(|(_, party)| now.saturating_sub(party.absent_since) > ABSENCE);
        let gone = away.iter().take(too_many).chain(long).map(|(name, _)| **name);
        let ended = self.known.iter().filter(|(_, party)| !holds(&party.right)).map(|(name, _)| *name);
        let gone: BTreeSet<Name> = gone.chain(ended).collect();
        for name in &gone {
            if self.known.remove(name).is_some_and(|mut party| party.leave(now)) {
                self.changed.send_replace(());
            }
        }
        gone
    }

    /// Removes all parties and returns them.
    pub fn clear(&mut self, now: u64) -> BTreeSet<Name> {
        let mut known = std::mem::take(&mut self.known);
        if known.values_mut().filter_map(|party| party.leave(now).then_some(())).count() > 0 {
            self.changed.send_replace(());
        }
        known.into_keys().collect()
    }

    /// Returns the right of a known party, attached or detached, and the time of its announcement.
    pub fn right(&self, entity: &Name) -> Option<(u64, &Counterpart)> {
        self.known.get(entity).map(|party| (party.stated_at, &party.right))
    }

    /// Returns the attached servers, the preferred one first. `cost` returns the cost of the path
    /// to a switch.
    pub fn instances(&self, cost: impl Fn(&Name) -> Option<u64>) -> Vec<Instance> {
        let mut instances: Vec<_> = self.attached(cost).collect();
        instances.sort_unstable_by(Instance::order);
        instances
    }

    pub fn is_attached(&self, entity: &Name) -> bool {
        self.known.get(entity).is_some_and(|party| party.presence.is_some())
    }

    pub fn attached_count(&self) -> usize {
        self.known.values().filter(|party| party.presence.is_some()).count()
    }

    /// Reserves a call at `one`, or at the preferred server. Returns `None` if there is no such
    /// attached server.
    pub fn choose(&self, one: Option<&Name>, cost: impl Fn(&Name) -> Option<u64>) -> Option<PendingCall> {
        let chosen = match one {
            Some(one) => *one,
            None => self.attached(cost).min_by(Instance::order)?.name,
        };
        let presence = self.known.get(&chosen)?.presence.clone()?;
        presence.calls.fetch_add(1, atomic::Ordering::Relaxed);
        Some(PendingCall { instance: chosen, presence })
    }

    fn attached(&self, cost: impl Fn(&Name) -> Option<u64>) -> impl Iterator<Item = Instance> {
        self.known.iter().filter_map(move |(name, party)| {
            let waiting = party.presence.as_ref()?.calls.load(atomic::Ordering::Relaxed);
            Some(Instance { name: *name, cost: cost(&party.right.switch), waiting, tie: party.tie })
        })
    }
}

/// Merges the rights of an entity in several services. The result is valid as long as any of them,
/// and has the key that the entity presented last.
pub fn joint_right<'a>(rights: impl Iterator<Item = (u64, &'a Counterpart)>) -> Option<Counterpart> {
    let mut joint: Option<(u64, Counterpart)> = None;
    for (stated_at, right) in rights {
        joint = Some(match joint {
            None => (stated_at, right.clone()),
            Some((newest, held)) => {
                let not_after = held.not_after.max(right.not_after);
                let (stated_at, mut newer) =
                    if stated_at > newest { (stated_at, right.clone()) } else { (newest, held) };
                newer.not_after = not_after;
                (stated_at, newer)
            }
        });
    }
    joint.map(|(_, right)| right)
}

#[cfg(test)]
#[path = "../../tests/unit/node/service_instances.rs"]
mod tests;
