//! The registrations of a node without I/O: those that the node wants, those that the master has
//! accepted, and those that it has forgotten.

use std::collections::{BTreeMap, BTreeSet};

use crate::api::master::SystemState;

/// What is registered, under a full name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum RegistrationKind {
    Publisher,
    Subscriber,
    Service,
}

/// One registration: what, and of which topic or service.
pub type Key = (RegistrationKind, String);

/// What to ask the master for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RegistrationStep {
    /// `kind`: the type of a topic, or `*`; empty for services.
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
    /// How often the master has forgotten it.
    run: u64,
    /// Of a subscriber's topic: who publishes it, as the master said last.
    publishers: BTreeSet<String>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum RegistrationState {
    Wanted,
    Registered,
    /// The master's reason. Asked again at the next look at the master.
    Refused(String),
    /// To be unregistered.
    Leaving,
}

impl Registrations {
    /// Asks for a registration. One that is just being taken back is wanted again.
    pub fn want(&mut self, key: Key, kind: String) {
        let run = self.entries.get(&key).map_or(0, |entry| entry.run);
        self.entries
            .insert(key, MasterEntry { kind, state: RegistrationState::Wanted, run, publishers: BTreeSet::new() });
    }

    /// Takes one back. Also of one that is not known to be registered: the answer may have been
    /// lost.
    pub fn leave(&mut self, key: &Key) {
        if let Some(entry) = self.entries.get_mut(key) {
            entry.state = RegistrationState::Leaving;
        }
    }

    /// Takes all back.
    pub fn leave_all(&mut self) {
        self.entries.values_mut().for_each(|entry| entry.state = RegistrationState::Leaving);
    }

    /// What to ask for next. It stays next until [`Self::done`] or [`Self::refused`].
    pub fn next(&self) -> Option<RegistrationStep> {
        self.entries.iter().find_map(|(key, entry)| match entry.state {
            RegistrationState::Wanted => {
                Some(RegistrationStep::Register { key: key.clone(), kind: entry.kind.clone() })
            }
            RegistrationState::Leaving => Some(RegistrationStep::Unregister { key: key.clone() }),
            RegistrationState::Registered | RegistrationState::Refused(_) => None,
        })
    }

    /// The master did it. What was asked for meanwhile counts: a step whose opposite is wanted now
    /// does not end anything.
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

    /// The master will not do it.
    pub fn refused(&mut self, step: &RegistrationStep, reason: String) {
        match step {
            RegistrationStep::Register { key, .. } => {
                if let Some(entry) = self.entries.get_mut(key).filter(|entry| entry.state == RegistrationState::Wanted)
                {
                    entry.state = RegistrationState::Refused(reason);
                }
            }
            // It is not there, or not ours.
            RegistrationStep::Unregister { .. } => self.done(step),
        }
    }

    /// Compares with what the master says of `node`: what it has forgotten is wanted again, and so
    /// is what it refused. A subscriber asks again too when others publish its topic than before,
    /// because the master's word that they do may have been lost. Returns how many registrations
    /// were forgotten.
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

    /// How often the master has forgotten a subscription.
    pub fn run_of(&self, key: &Key) -> u64 {
        self.entries.get(key).map_or(0, |entry| entry.run)
    }

    /// Whether there are none, not even such as are being taken back.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// How many the master has still to be told of, or has refused.
    pub fn pending(&self) -> usize {
        self.entries.values().filter(|entry| entry.state != RegistrationState::Registered).count()
    }

    /// What the master refused, with its reasons.
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
