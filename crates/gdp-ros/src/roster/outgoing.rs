//! The sending side of rosters. It numbers the publishers of a topic in a ROS graph, and decides
//! when the proxy sends a roster.

use std::collections::{BTreeMap, HashMap};
use std::time::{Duration, Instant};

use gdp::unstable::Publisher;
use gdp_core::cbor::CborError;
use gdp_msg::Schema;
use gdp_util::ticks::next_tick;

use super::{
    Kind, LEASE, MAX_DEFINITION, MAX_WRITERS, Offer, REFRESH, ROSTER, Roster, VERSION, Writer, node_name, origin,
};

/// The roster of a topic that this proxy publishes. `K` identifies a publisher in the ROS graph.
pub struct Outgoing<K> {
    kind: Kind,
    definition: Option<String>,
    numbers: HashMap<K, u32>,
    writers: BTreeMap<u32, Writer>,
    /// The number of the next publisher that joins.
    next: u32,
    changed: bool,
    /// When the next roster is due if nothing changes.
    due: Option<Instant>,
    /// Number of brief rosters since the last whole one.
    briefs: u32,
}

/// Number of brief rosters between two whole ones.
const BRIEFS: u32 = 10;

/// Returns the roster of a program that is the only publisher of a name, and the origin that its
/// messages state.
pub fn single(kind: Kind, schema: &Schema, offer: Offer) -> (Outgoing<()>, [u8; 4]) {
    let text = Some(schema.text()).filter(|text| text.len() <= MAX_DEFINITION);
    let mut roster = Outgoing::new(kind, text);
    roster.joined((), "", offer);
    let number = roster.number(&()).unwrap_or_default();
    (roster, origin(number))
}

/// A roster to send.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Announcement {
    /// A roster with the definition. The proxy also pins it in place of the previous one.
    Whole(Vec<u8>),
    /// A roster without the definition, for readers that have the pinned one.
    Brief(Vec<u8>),
}

impl<K: std::hash::Hash + Eq> Outgoing<K> {
    pub fn new(kind: Kind, definition: Option<String>) -> Self {
        let (numbers, writers) = (HashMap::new(), BTreeMap::new());
        Self { kind, definition, numbers, writers, next: 0, changed: true, due: None, briefs: 0 }
    }

    /// Adds a publisher, or changes its QoS. Ignores new publishers beyond [`MAX_WRITERS`].
    pub fn joined(&mut self, key: K, node: &str, offers: Offer) {
        let node = node_name(node);
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
        let writer = Writer { number, node: node.to_owned(), alive: true, offers };
        self.changed |= self.writers.insert(number, writer.clone()) != Some(writer);
    }

    /// Records whether the lease of a publisher's liveliness is in force.
    pub fn set_alive(&mut self, key: &K, alive: bool) {
        let writer = self.numbers.get(key).and_then(|number| self.writers.get_mut(number));
        if let Some(writer) = writer.filter(|writer| writer.alive != alive) {
            writer.alive = alive;
            self.changed = true;
        }
    }

    /// Removes a publisher and returns its number.
    pub fn left(&mut self, key: &K) -> Option<u32> {
        let number = self.numbers.remove(key)?;
        self.writers.remove(&number);
        self.changed = true;
        Some(number)
    }

    /// Makes the next roster a whole one, because the name has a new session and readers know
    /// nothing.
    pub fn again(&mut self) {
        self.changed = true;
    }

    /// Returns the number of a publisher.
    pub fn number(&self, key: &K) -> Option<u32> {
        self.numbers.get(key).copied()
    }

    /// Returns all publishers with their numbers.
    pub fn numbers(&self) -> impl Iterator<Item = (&K, u32)> {
        self.numbers.iter().map(|(key, number)| (key, *number))
    }

    /// Returns number and QoS of all publishers.
    pub fn offers(&self) -> impl Iterator<Item = (u32, Offer)> {
        self.writers.iter().map(|(number, writer)| (*number, writer.offers))
    }

    /// Returns the interval between two rosters: [`REFRESH`], or a quarter of the shortest lease if
    /// that is less. So three rosters in a row may be lost before a lease expires.
    fn refresh(&self) -> Duration {
        let lease = self.writers.values().map(|writer| writer.offers.lease()).min().unwrap_or(LEASE);
        REFRESH.min(lease / 4)
    }

    /// Returns when the next roster is due if nothing changes.
    pub fn due(&self) -> Option<Instant> {
        self.due
    }

    /// Returns a roster without publishers, for when the proxy no longer carries them.
    pub fn farewell(&self) -> Result<Vec<u8>, CborError> {
        Roster { version: VERSION, kind: self.kind.clone(), definition: None, writers: vec![] }.to_bytes()
    }

    /// Sends the roster, if one is due. `publisher` is that of the topic's name.
    pub fn announce(&mut self, now: Instant, publisher: &Publisher) -> Result<(), CborError> {
        match self.poll(now)? {
            Some(Announcement::Whole(body)) => publisher.pin(ROSTER, &body),
            Some(Announcement::Brief(body)) => publisher.mention(ROSTER, &body),
            None => {}
        }
        Ok(())
    }

    /// Returns the roster to send now, if any is due.
    pub(super) fn poll(&mut self, now: Instant) -> Result<Option<Announcement>, CborError> {
        if !self.changed && self.due.is_some_and(|due| now < due) {
            return Ok(None);
        }
        // A best-effort reader may have lost the previous whole roster.
        let whole = std::mem::take(&mut self.changed) || self.briefs >= BRIEFS;
        self.briefs = if whole { 0 } else { self.briefs + 1 };
        // All topics together, so that one frame acknowledges them.
        self.due = Some(next_tick(self.refresh(), now));
        let writers = self.writers.values().cloned().collect();
        let definition = self.definition.clone().filter(|_| whole);
        let bytes = Roster { version: VERSION, kind: self.kind.clone(), definition, writers }.to_bytes()?;
        Ok(Some(if whole { Announcement::Whole(bytes) } else { Announcement::Brief(bytes) }))
    }
}
