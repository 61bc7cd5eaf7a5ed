//! The registrations of a node, without I/O: those that the node wants, those that the master has
//! accepted, and those that the master has lost.

use std::collections::{BTreeMap, BTreeSet};

use crate::api::master::SystemState;

/// What a node registers, under a global name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum RegistrationKind {
    Publisher,
    Subscriber,
    Service,
}

/// The key of one registration: its kind, and the name of the topic or service.
pub type Key = (RegistrationKind, String);

/// The next call to the master.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RegistrationStep {
    /// `kind` is the type of a topic or `*`. It is empty for a service.
    Register {
        key: Key,
        kind: String,
    },
    Unregister {
        key: Key,
    },
}

/// All registrations of one node.
#[derive(Default)]
pub struct Registrations {
    entries: BTreeMap<Key, MasterEntry>,
}

struct MasterEntry {
    kind: String,
    state: RegistrationState,
    /// Number of times that the master has lost this registration.
    run: u64,
    /// The publishers of a subscriber's topic in the last system state of the master.
    publishers: BTreeSet<String>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum RegistrationState {
    Wanted,
    Registered,
    /// The master's reason for its refusal. The next system state makes the node try again.
    Refused(String),
    /// The node must unregister it.
    Leaving,
}

impl Registrations {
    /// Adds a registration. An entry that is being unregistered becomes wanted again.
    pub fn want(&mut self, key: Key, kind: String) {
        let run = self.entries.get(&key).map_or(0, |entry| entry.run);
        self.entries
            .insert(key, MasterEntry { kind, state: RegistrationState::Wanted, run, publishers: BTreeSet::new() });
    }

    /// Marks a registration for unregistration. This includes one that is not known to be
    /// registered, because the master's response may have been lost.
    pub fn leave(&mut self, key: &Key) {
        if let Some(entry) = self.entries.get_mut(key) {
            entry.state = RegistrationState::Leaving;
        }
    }

    /// Marks all registrations for unregistration.
    pub fn leave_all(&mut self) {
        self.entries.values_mut().for_each(|entry| entry.state = RegistrationState::Leaving);
    }

    /// Returns the next call to the master. It stays the same until [`Self::done`] or
    /// [`Self::refused`].
    pub fn next(&self) -> Option<RegistrationStep> {
        self.entries.iter().find_map(|(key, entry)| match entry.state {
            RegistrationState::Wanted => {
                Some(RegistrationStep::Register { key: key.clone(), kind: entry.kind.clone() })
            }
            RegistrationState::Leaving => Some(RegistrationStep::Unregister { key: key.clone() }),
            RegistrationState::Registered | RegistrationState::Refused(_) => None,
        })
    }

    /// Records that the master accepted a call. Ignores it if the opposite has been requested
    /// since.
    pub fn done(&mut self, step: &RegistrationStep) {
        match step {
            RegistrationStep::Register { key, .. } => {
                if let Some(entry) = self.entries.get_mut(key).filter(|entry| entry.state == RegistrationState::Wanted)
                {
                    entry.state = RegistrationState::Registered;
                }
            }
            RegistrationStep::Unregister { key } => {
                if self.entries.get(key).is_some_and(|entry| entry.state == RegistrationState::Leaving) {
                    self.entries.remove(key);
                }
            }
        }
    }

    /// Records that the master refused a call.
    pub fn refused(&mut self, step: &RegistrationStep, reason: String) {
        match step {
            RegistrationStep::Register { key, .. } => {
                if let Some(entry) = self.entries.get_mut(key).filter(|entry| entry.state == RegistrationState::Wanted)
                {
                    entry.state = RegistrationState::Refused(reason);
                }
            }
            // The master does not have this registration, or it belongs to another node.
            RegistrationStep::Unregister { .. } => self.done(step),
        }
    }

    /// Compares the registrations of `node` with the master's system state. Registrations that the
    /// master lost or refused become wanted again. A subscriber also registers again when the
    /// publishers of its topic have changed, because a `publisherUpdate` may have been lost.
    /// Returns the number of lost registrations.
    pub fn observe(&mut self, node: &str, master: &SystemState) -> usize {
        let by_name = |listed: &'_ [(String, Vec<String>)]| -> BTreeMap<String, BTreeSet<String>> {
            listed.iter().map(|(name, nodes)| (name.clone(), nodes.iter().cloned().collect())).collect()
        };
        let [publishers, subscribers, services] =
            [&master.publishers, &master.subscribers, &master.services].map(|listed| by_name(listed));
        let mut forgotten = 0;
        for ((kind, name), entry) in &mut self.entries {
            let listed = match kind {
                RegistrationKind::Publisher => &publishers,
                RegistrationKind::Subscriber => &subscribers,
                RegistrationKind::Service => &services,
            };
            let is_listed = listed.get(name).is_some_and(|nodes| nodes.contains(node));
            match entry.state {
                RegistrationState::Refused(_) => entry.state = RegistrationState::Wanted,
                RegistrationState::Registered if !is_listed => {
                    entry.state = RegistrationState::Wanted;
                    entry.run += 1;
                    forgotten += 1;
                }
                _ => {}
            }
            let others = publishers.get(name).cloned().unwrap_or_default();
            if *kind == RegistrationKind::Subscriber && entry.publishers != others {
                entry.publishers = others;
                if entry.state == RegistrationState::Registered {
                    entry.state = RegistrationState::Wanted;
                }
            }
        }
        forgotten
    }

    /// Returns how often the master has lost a registration.
    pub fn run_of(&self, key: &Key) -> u64 {
        self.entries.get(key).map_or(0, |entry| entry.run)
    }

    /// Returns whether there are no registrations, including those that are being unregistered.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Returns the number of registrations that are not in force at the master.
    pub fn pending(&self) -> usize {
        self.entries.values().filter(|entry| entry.state != RegistrationState::Registered).count()
    }

    /// Returns the registrations that the master refused, with its reasons.
    pub fn refusals(&self) -> Vec<(Key, String)> {
        let refused = |(key, entry): (&Key, &MasterEntry)| match &entry.state {
            RegistrationState::Refused(reason) => Some((key.clone(), reason.clone())),
            _ => None,
        };
        self.entries.iter().filter_map(refused).collect()
    }
}

#[cfg(test)]
#[path = "../tests/unit/registration.rs"]
mod tests;
