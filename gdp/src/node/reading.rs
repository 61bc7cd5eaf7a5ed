//! The writers and keys of a name that this node reads.
//!
//! Verified updates of the RIB are inputs, changes for the receiving thread are outputs. No I/O.

use std::collections::{HashMap, VecDeque};

use gdp_wire::Name;

use super::subscription_receiver::Change;
use gdp_core::cert::{Revocation, Signed};
use gdp_core::crypto::PUBLIC_KEY_LEN;
use gdp_core::identity::Identity;
use gdp_core::keys::KeyBox;
use gdp_e2e::feedback_wire::Feedback;
use gdp_e2e::keys::{KeyStore, MAX_WRITERS, StoreError};
use gdp_proto::peers::{Counterpart, PeerEvent};

/// Limits of the authorised writers of one name, and of key boxes from unknown writers. The RIB may
/// announce such a writer in a later message.
struct Bounds {
    writers: usize,
    early: usize,
}

const TOPIC: Bounds = Bounds { writers: 256, early: 64 };
/// Limits for the node's own name, which all its servers and callers write to.
const INBOX: Bounds = Bounds { writers: MAX_WRITERS, early: MAX_WRITERS };

pub struct Reading {
    name: Name,
    bounds: Bounds,
    keys: KeyStore,
    /// Authorised writers, attached or detached. Removing a writer would lose the record of its
    /// delivered messages.
    writers: HashMap<Name, Counterpart>,
    revocation: Option<Revocation>,
    /// Key boxes with the writer that each names.
    early: VecDeque<(Name, Signed<KeyBox>)>,
    /// Writers whose latest box has a lower epoch than the newest one here, and how often they are
    /// still told.
    behind: HashMap<Name, u32>,
}

/// How often a writer is told that its epochs are behind: at once, and every few seconds.
const TELLINGS: u32 = 5;

/// An effect on the node.
#[derive(Debug)]
pub enum Effect {
    /// A change for the receiving thread.
    Change(Change),
    /// The node shares a pair key with this writer from now on.
    Introduce(Name, [u8; PUBLIC_KEY_LEN]),
    /// The node no longer shares a pair key with this writer.
    Part(Name),
    /// Feedback for this writer.
    Tell(Name, Feedback),
}

impl Reading {
    pub fn new(name: Name, reader: &Identity) -> Self {
        Self {
            name,
            bounds: if name == reader.name() { INBOX } else { TOPIC },
            keys: KeyStore::new(name, reader),
            writers: HashMap::new(),
            revocation: None,
            early: VecDeque::new(),
            behind: HashMap::new(),
        }
    }

    /// Processes the RIB's updates at `now` (Unix nanoseconds).
    pub fn take(&mut self, now: u64, events: impl IntoIterator<Item = PeerEvent>) -> Vec<Effect> {
        let mut effects = Vec::new();
        for event in events {
            match event {
                PeerEvent::Joined(writer) => {
                    let entity = writer.entity;
                    self.join(writer, &mut effects);
                    let early = std::mem::take(&mut self.early).into_iter();
                    let (its, others): (VecDeque<_>, _) = early.partition(|(writer, _)| *writer == entity);
                    self.early = others;
                    its.into_iter().for_each(|(_, signed)| self.open(now, signed, &mut effects));
                }
                PeerEvent::KeyBox(signed) => self.open(now, signed, &mut effects),
                PeerEvent::Revoked(revocation) => self.revocation = Some(revocation),
                PeerEvent::Refused(error) => {
                    tracing::warn!(name = %self.name, %error, "the RIB told of a writer that does not verify");
                }
                // A writer stays authorised while its right is valid, independent of attachment and
                // domain membership. The supervisor handles a RIB that lacks a revocation.
                PeerEvent::Left(_) | PeerEvent::Expelled(_) | PeerEvent::RibIsBehind(_) => {}
            }
        }
        effects.extend(self.expire(now));
        effects
    }

    /// Removes what has expired by now: rights of writers, and old keys for late messages.
    pub fn expire(&mut self, now: u64) -> Vec<Effect> {
        let unix = now / 1_000_000_000;
        let holds = |writer: &Counterpart| {
            writer.not_after >= unix && self.revocation.as_ref().is_none_or(|revocation| writer.holds(revocation))
        };
        let ended: Vec<Name> =
            self.writers.values().filter(|writer| !holds(writer)).map(|writer| writer.entity).collect();
        let mut effects = Vec::new();
        ended.iter().for_each(|writer| effects.extend(self.forget(writer)));
        let over = self.keys.expire(now).into_iter();
        effects.extend(over.map(|(writer, epoch)| Effect::Change(Change::DropKey { writer, epoch })));
        self.tell_behind(&mut effects);
        effects
    }

    /// Removes the authorisation of a writer.
    pub fn forget(&mut self, writer: &Name) -> Vec<Effect> {
        if self.writers.remove(writer).is_none() {
            return Vec::new();
        }
        self.keys.forget(writer);
        self.behind.remove(writer);
        vec![Effect::Change(Change::Revoke { writer: *writer }), Effect::Part(*writer)]
    }

    pub fn writers(&self) -> impl Iterator<Item = &Name> {
        self.writers.keys()
    }

    fn join(&mut self, writer: Counterpart, effects: &mut Vec<Effect>) {
        let Counterpart { entity, key, box_key, .. } = writer;
        let known = self.writers.get(&entity).map(|known| known.box_key);
        let most = self.bounds.writers;
        if known.is_none() && self.writers.len() >= most {
            tracing::warn!(name = %self.name, writer = %entity, "more than {most} writers of one name; this one is not believed");
            return;
        }
        if known != Some(box_key) {
            effects.push(Effect::Introduce(entity, box_key));
            effects.extend(known.map(|_| Effect::Part(entity)));
        }
        effects.push(Effect::Change(Change::Authorise { writer: entity, key }));
        self.writers.insert(entity, writer);
    }

    fn open(&mut self, now: u64, signed: Signed<KeyBox>, effects: &mut Vec<Effect>) {
        if let Err(error) = self.try_open(now, signed, effects) {
            tracing::warn!(name = %self.name, %error, "a key box is of no use");
        }
    }

    /// Shows writers whose epochs are behind the newest box that is held of them.
    fn tell_behind(&mut self, effects: &mut Vec<Effect>) {
        let Self { name, keys, behind, .. } = self;
        behind.retain(|writer, left| {
            *left -= 1;
            let held = keys.newest(writer).map(|key_box| Feedback::NewestKey { name: *name, key_box: key_box.clone() });
            effects.extend(held.map(|held| Effect::Tell(*writer, held)));
            *left > 0
        });
    }

    /// Opens a key box, or queues it if its writer is not known yet.
    fn try_open(&mut self, now: u64, signed: Signed<KeyBox>, effects: &mut Vec<Effect>) -> Result<(), StoreError> {
        let writer = signed.claims_unverified()?.writer;
        let Some(known) = self.writers.get(&writer) else {
            if self.early.len() == self.bounds.early {
                self.early.pop_front();
            }
            self.early.push_back((writer, signed));
            return Ok(());
        };
        let opened = self.keys.take(now, writer, &known.key, &signed);
        if let Err(StoreError::Over { .. }) = opened {
            // The writer may have restarted with a clock that was set back.
            self.behind.entry(writer).or_insert(TELLINGS);
        }
        let opened = opened?;
        if opened.as_ref().is_some_and(|opened| Some(opened.epoch) == self.keys.newest_epoch(&writer)) {
            self.behind.remove(&writer);
        }
        effects.extend(opened.map(|opened| Effect::Change(Change::Key { writer, opened })));
        Ok(())
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/reading.rs"]
mod tests;
