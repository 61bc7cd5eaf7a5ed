//! Synchronises a set of entries to a remote peer: deltas while the peer follows, and the full set
//! in parts after each (re)connect. [`Feed`] is pure state and independent of the type of entry.
//! The RIB keeps one feed for the FIB of each switch, tiers keep one for each neighbouring domain.
//! The owner sends what [`Feed::next`] returns.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Bound::{Excluded, Unbounded};
use std::time::Duration;

use gdp_proto::control::Extent;
use gdp_util::backoff::Backoff;

use crate::delta_sync::{DeltaSync, NextMessage};

/// Delay between a failed push and the next full transfer.
const RETRY: Duration = Duration::from_millis(500);

/// Delay before the feed sends again what the peer accepted only in part.
const PARTLY: Backoff = Backoff::new(Duration::from_secs(60), Duration::from_secs(16 * 60));

/// Desired entries of one peer, and how much of them the peer is known to hold.
#[derive(Debug)]
pub struct Feed<K, V> {
    entries: BTreeMap<K, V>,
    sync: DeltaSync<K>,
    generation: u64,
    /// Pushes that failed in a row.
    failures: u32,
    /// Push that the peer has not answered yet.
    in_flight: Option<InFlight<K>>,
    partly: Partly<K>,
}

/// Entries that the peer accepted only in part for lack of room. The feed sends them again later,
/// even if nothing changes here.
#[derive(Debug)]
struct Partly<K> {
    /// Keys of all partly accepted pushes. The peer does not state which of them it refused.
    keys: BTreeSet<K>,
    /// Time at which the keys are sent again.
    at: Option<Duration>,
    /// Number of resends in a row.
    times: u32,
}

/// One push to the peer.
#[derive(Debug)]
pub struct Push<K, V> {
    pub generation: u64,
    pub extent: Extent,
    pub set: Vec<V>,
    pub remove: Vec<K>,
}

/// Capacity of one push.
#[derive(Clone, Copy, Debug)]
pub struct Room {
    pub entries: usize,
    pub bytes: usize,
}

#[derive(Debug)]
struct InFlight<K> {
    generation: u64,
    keys: BTreeSet<K>,
}

impl<K, V> Default for Feed<K, V> {
    fn default() -> Self {
        let partly = Partly { keys: BTreeSet::new(), at: None, times: 0 };
        Self { entries: BTreeMap::new(), sync: DeltaSync::new(), generation: 0, failures: 0, in_flight: None, partly }
    }
}

impl<K: Ord + Copy, V: PartialEq + Clone> Feed<K, V> {
    /// Sets the desired value of `key`, or removes the key if `value` is `None`.
    pub fn set(&mut self, key: K, value: Option<V>) {
        if self.entries.get(&key) != value.as_ref() {
            self.sync.change(key, ());
        }
        match value {
            Some(value) => self.entries.insert(key, value),
            None => self.entries.remove(&key),
        };
    }

    /// Returns all entries that the peer should hold.
    pub fn entries(&self) -> &BTreeMap<K, V> {
        &self.entries
    }

    /// Starts a full transfer. The feed ignores the answer to a push still in flight.
    pub fn restart(&mut self) {
        self.sync.restart();
        self.in_flight = None;
        // The full transfer includes the partly accepted entries.
        (self.partly.keys, self.partly.at) = (BTreeSet::new(), None);
    }

    /// Returns the next push, or `None` if one is in flight or nothing has changed.
    ///
    /// `size` returns the bytes of an entry, or of a removed key if given `None`. A single entry is
    /// always pushed, even if it exceeds `room`.
    pub fn next(&mut self, now: Duration, room: Room, size: impl Fn(Option<&V>) -> usize) -> Option<Push<K, V>> {
        debug_assert!(room.entries > 0, "a push has room for an entry");
        if self.in_flight.is_some() {
            return None;
        }
        if self.sync.retry_at().is_some_and(|retry| now >= retry) {
            self.restart();
        }
        if self.partly.at.take_if(|at| now >= *at).is_some() {
            self.partly.times += 1;
            let again = std::mem::take(&mut self.partly.keys).into_iter();
            again.filter(|key| self.entries.contains_key(key)).for_each(|key| self.sync.change(key, ()));
        }
        let entries = &self.entries;
        let mut filling = Filling { whole: room, left: room };
        let (mut keys, mut set, mut remove) = (BTreeSet::new(), Vec::new(), Vec::new());
        let extent = match self.sync.next_message()? {
            NextMessage::Part { after } => {
                let mut rest = entries.range((after.map_or(Unbounded, Excluded), Unbounded)).peekable();
                while let Some((key, value)) = rest.next_if(|(_, value)| filling.takes(size(Some(value)))) {
                    keys.insert(*key);
                    set.push(value.clone());
                }
                let end = rest.peek().and(keys.last().copied());
                let part = self.sync.part_composed(end);
                Extent::Full { part: part.number, last: part.is_last }
            }
            NextMessage::Delta => {
                while let Some((key, ())) = self.sync.next_change(|key| filling.takes(size(entries.get(key)))) {
                    keys.insert(key);
                    match entries.get(&key) {
                        Some(value) => set.push(value.clone()),
                        None => remove.push(key),
                    }
                }
                Extent::Delta
            }
        };
        self.generation += 1;
        self.in_flight = Some(InFlight { generation: self.generation, keys });
        Some(Push { generation: self.generation, extent, set, remove })
    }

    /// Records whether the push with this generation succeeded. Returns whether that push was in
    /// flight.
    ///
    /// After a failure, the feed starts a full transfer a moment later.
    pub fn answered(&mut self, now: Duration, generation: u64, done: bool) -> bool {
        if self.in_flight.take_if(|push| push.generation == generation).is_none() {
            return false;
        }
        self.failures = if done { 0 } else { self.failures.saturating_add(1) };
        if !done {
            self.sync.failed(now + RETRY);
        } else if !self.lacks() && self.sync.is_following() && !self.sync.has_changes() {
            self.partly.times = 0;
        }
        true
    }

    /// Records that the peer accepted only part of the push. The feed sends its entries again
    /// later.
    pub fn answered_partly(&mut self, now: Duration, generation: u64) {
        let Some(push) = self.in_flight.take_if(|push| push.generation == generation) else { return };
        self.failures = 0;
        self.partly.keys.extend(push.keys);
        self.partly.at.get_or_insert(now + PARTLY.after(self.partly.times + 1));
    }

    /// Returns whether the peer has accepted some push only in part.
    pub fn lacks(&self) -> bool {
        self.partly.at.is_some()
    }

    /// Returns whether the peer has answered the current value of this key.
    ///
    /// Also returns true once pushes have failed more than once, because waiting is then pointless.
    pub fn is_settled(&self, key: &K) -> bool {
        if self.sync.retry_at().is_some() {
            return self.failures > 1;
        }
        self.sync.is_sent(key) && self.in_flight.as_ref().is_none_or(|push| !push.keys.contains(key))
    }

    /// Returns the generation that the peer is known to hold.
    pub fn acknowledged(&self) -> Option<u64> {
        (self.sync.is_following() && self.in_flight.is_none()).then_some(self.generation)
    }

    /// Returns the time at which [`Self::next`] should be called again if nothing else happens.
    pub fn retry_at(&self) -> Option<Duration> {
        self.sync.retry_at().or(self.partly.at)
    }
}

/// Remaining capacity of a push.
struct Filling {
    whole: Room,
    left: Room,
}

impl Filling {
    fn takes(&mut self, size: usize) -> bool {
        let is_empty = self.left.entries == self.whole.entries;
        if self.left.entries == 0 || (self.left.bytes < size && !is_empty) {
            return false;
        }
        self.left.entries -= 1;
        self.left.bytes = self.left.bytes.saturating_sub(size);
        true
    }
}
