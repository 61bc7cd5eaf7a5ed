//! Synchronises a set of entries to a remote peer. [`Feed`] sends deltas while the peer follows,
//! and the full set in parts after each (re)connect. It is pure state and independent of the type
//! of entry. The RIB keeps one feed for the FIB of each switch, tiers keep one for each
//! neighbouring domain. The owner sends what [`Feed::next`] returns.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Bound::{Excluded, Included, Unbounded};
use std::time::Duration;

use gdp_proto::control::Extent;

/// Delay between a failed push and the next full transfer.
const RETRY: Duration = Duration::from_millis(500);

/// Initial and maximum delay before the feed sends again what the peer accepted only in part. The
/// delay doubles with each partial acceptance in a row.
const TELL_AGAIN: Duration = Duration::from_secs(60);
const TELL_AGAIN_AT_MOST: Duration = Duration::from_secs(16 * 60);

/// Desired entries of one peer, and how much of them the peer is known to hold.
#[derive(Debug)]
pub struct Feed<K, V> {
    entries: BTreeMap<K, V>,
    /// Keys whose desired value differs from the value sent last.
    dirty: BTreeSet<K>,
    generation: u64,
    phase: Phase<K>,
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
pub struct Parcel<K, V> {
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

#[derive(Debug, PartialEq, Eq)]
enum Phase<K> {
    /// The peer receives the full set. `part` is the number of the next part, which starts behind
    /// key `after`.
    Full { part: u32, after: Option<K> },
    /// The peer holds every entry except the dirty ones.
    Following,
    /// A push failed. The feed starts a full transfer at `retry`.
    Failed { retry: Duration },
}

impl<K, V> Default for Feed<K, V> {
    fn default() -> Self {
        let phase = Phase::Full { part: 0, after: None };
        let (entries, dirty) = Default::default();
        let partly = Partly { keys: BTreeSet::new(), at: None, times: 0 };
        Self { entries, dirty, generation: 0, phase, failures: 0, in_flight: None, partly }
    }
}

impl<K: Ord + Copy, V: PartialEq + Clone> Feed<K, V> {
    /// Sets the desired value of `key`, or removes the key if `value` is `None`.
    pub fn set(&mut self, key: K, value: Option<V>) {
        if self.entries.get(&key) != value.as_ref() {
            self.dirty.insert(key);
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
        self.phase = Phase::Full { part: 0, after: None };
        self.in_flight = None;
        // The full transfer includes the partly accepted entries.
        (self.partly.keys, self.partly.at) = (BTreeSet::new(), None);
    }

    /// Returns the next push, or `None` if one is in flight or nothing has changed.
    ///
    /// `size` returns the bytes of an entry, or of a removed key if given `None`. A single entry is
    /// always pushed, even if it exceeds `room`.
    pub fn next(&mut self, now: Duration, room: Room, size: impl Fn(Option<&V>) -> usize) -> Option<Parcel<K, V>> {
        if self.in_flight.is_some() {
            return None;
        }
        if matches!(self.phase, Phase::Failed { retry } if now >= retry) {
            self.restart();
        }
        if self.partly.at.take_if(|at| now >= *at).is_some() {
            self.partly.times += 1;
            let again = std::mem::take(&mut self.partly.keys).into_iter();
            self.dirty.extend(again.filter(|key| self.entries.contains_key(key)));
        }
        let (entries, dirty) = (&self.entries, &mut self.dirty);
        let mut filling = Filling { whole: room, left: room };
        let (mut keys, mut set, mut remove) = (BTreeSet::new(), Vec::new(), Vec::new());
        let extent = match &mut self.phase {
            Phase::Failed { .. } => return None,
            Phase::Full { part, after } => {
                let start = *after;
                let mut rest = entries.range((start.map_or(Unbounded, Excluded), Unbounded)).peekable();
                while let Some((key, value)) = rest.next_if(|(_, value)| filling.takes(size(Some(value)))) {
                    keys.insert(*key);
                    set.push(value.clone());
                }
                let last = rest.peek().is_none();
                // This part covers all dirty keys in its range. Dirty keys before it wait for a
                // delta.
                let end = if last { None } else { keys.last().copied() };
                let page = (start.map_or(Unbounded, Excluded), end.map_or(Unbounded, Included));
                dirty.extract_if(page, |_| true).for_each(drop);
                let extent = Extent::Full { part: *part, last };
                self.phase = if last { Phase::Following } else { Phase::Full { part: *part + 1, after: end } };
                extent
            }
            Phase::Following => {
                if dirty.is_empty() {
                    return None;
                }
                while let Some(key) = dirty.first() {
                    let value = entries.get(key);
                    if !filling.takes(size(value)) {
                        break;
                    }
                    keys.insert(*key);
                    match value {
                        Some(value) => set.push(value.clone()),
                        None => remove.push(*key),
                    }
                    dirty.pop_first();
                }
                Extent::Delta
            }
        };
        self.generation += 1;
        self.in_flight = Some(InFlight { generation: self.generation, keys });
        Some(Parcel { generation: self.generation, extent, set, remove })
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
            self.phase = Phase::Failed { retry: now + RETRY };
        } else if !self.lacks() && self.dirty.is_empty() && self.phase == Phase::Following {
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
        let pause = TELL_AGAIN.saturating_mul(1 << self.partly.times.min(16)).min(TELL_AGAIN_AT_MOST);
        self.partly.at.get_or_insert(now + pause);
    }

    /// Returns whether the peer has accepted some push only in part.
    pub fn lacks(&self) -> bool {
        self.partly.at.is_some()
    }

    /// Returns whether the peer has answered the current value of this key.
    ///
    /// Also returns true once pushes have failed more than once, because waiting is then pointless.
    pub fn is_settled(&self, key: &K) -> bool {
        let sent = match &self.phase {
            Phase::Failed { .. } => return self.failures > 1,
            Phase::Following => true,
            Phase::Full { after, .. } => after.is_some_and(|after| *key <= after),
        };
        sent && !self.dirty.contains(key) && self.in_flight.as_ref().is_none_or(|push| !push.keys.contains(key))
    }

    /// Returns the generation that the peer is known to hold.
    pub fn acknowledged(&self) -> Option<u64> {
        (self.phase == Phase::Following && self.in_flight.is_none()).then_some(self.generation)
    }

    /// Returns the time at which [`Self::next`] should be called again if nothing else happens.
    pub fn retry_at(&self) -> Option<Duration> {
        match self.phase {
            Phase::Failed { retry } => Some(retry),
            _ => self.partly.at,
        }
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
