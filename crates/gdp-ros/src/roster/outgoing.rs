//! The sending side of rosters: it numbers the publishers of a topic in a ROS graph, and decides
//! when a roster is sent.

use std::collections::{BTreeMap, HashMap};
use std::time::{Duration, Instant};

use gdp_core::cbor::CborError;

use super::{Kind, LEASE, MAX_WRITERS, Offer, REFRESH, Roster, VERSION, Writer};

/// Of a topic that goes out. `K` is what tells publishers apart in the ROS graph.
pub struct Outgoing<K> {
    kind: Kind,
    definition: Option<String>,
    numbers: HashMap<K, u32>,
    writers: BTreeMap<u32, Offer>,
    /// Of the next one that comes.
    next: u32,
    changed: bool,
    /// When a roster is due though nothing has changed.
    due: Option<Instant>,
    /// Since the last whole one.
    briefs: u32,
}

/// So many brief rosters, and a whole one again.
const BRIEFS: u32 = 10;

/// A roster that is to be sent.
#[derive(Debug, PartialEq, Eq)]
pub enum Announcement {
    /// And pinned, in place of the one before.
    Whole(Vec<u8>),
    /// To those who know what is pinned.
    Brief(Vec<u8>),
}

impl<K: std::hash::Hash + Eq> Outgoing<K> {
    pub fn new(kind: Kind, definition: Option<String>) -> Self {
        let (numbers, writers) = (HashMap::new(), BTreeMap::new());
        Self { kind, definition, numbers, writers, next: 0, changed: true, due: None, briefs: 0 }
    }

    /// A publisher is there, or offers something else. Of too many, what comes later has no number.
    pub fn joined(&mut self, key: K, offers: Offer) {
        let number = match self.numbers.get(&key) {
            Some(number) => *number,
            None if self.numbers.len() >= MAX_WRITERS => return,
            None => {
                let number = self.next;
                self.next = self.next.wrapping_add(1);
                self.numbers.insert(key, number);
                number
            }
        };
        self.changed |= self.writers.insert(number, offers) != Some(offers);
    }

    /// A publisher has gone: what number it had.
    pub fn left(&mut self, key: &K) -> Option<u32> {
        let number = self.numbers.remove(key)?;
        self.writers.remove(&number);
        self.changed = true;
        Some(number)
    }

    /// The name is published anew: nobody knows what was told.
    pub fn again(&mut self) {
        self.changed = true;
    }

    /// Of a publisher that is there.
    pub fn number(&self, key: &K) -> Option<u32> {
        self.numbers.get(key).copied()
    }

    /// Of all that are there.
    pub fn offers(&self) -> impl Iterator<Item = (u32, Offer)> {
        self.writers.iter().map(|(number, offers)| (*number, *offers))
    }

    /// How often a roster is sent: so that three may be lost before a publisher is missed.
    fn refresh(&self) -> Duration {
        let lease = self.writers.values().map(Offer::lease).min().unwrap_or(LEASE);
        REFRESH.min(lease / 4)
    }

    /// When the next roster is due, if nothing changes.
    pub fn due(&self) -> Option<Instant> {
        self.due
    }

    /// The publishers are not carried any more: what tells so.
    pub fn farewell(&self) -> Result<Vec<u8>, CborError> {
        Roster { version: VERSION, kind: self.kind.clone(), definition: None, writers: vec![] }.to_bytes()
    }

    /// What is to be sent now, if anything is.
    pub fn poll(&mut self, now: Instant) -> Result<Option<Announcement>, CborError> {
        if !self.changed && self.due.is_some_and(|due| now < due) {
            return Ok(None);
        }
        // What is best effort may have lost the one before.
        let whole = std::mem::take(&mut self.changed) || self.briefs >= BRIEFS;
        self.briefs = if whole { 0 } else { self.briefs + 1 };
        self.due = Some(now + self.refresh());
        let writers = self.writers.iter().map(|(number, offers)| Writer { number: *number, offers: *offers }).collect();
        let definition = self.definition.clone().filter(|_| whole);
        let bytes = Roster { version: VERSION, kind: self.kind.clone(), definition, writers }.to_bytes()?;
        Ok(Some(if whole { Announcement::Whole(bytes) } else { Announcement::Brief(bytes) }))
    }
}
