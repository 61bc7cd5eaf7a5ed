//! What another side should hold, and the pushes that bring it there: deltas while it follows, the
//! whole in parts after every (re)connect. Pure state, whatever the entries are: the RIB fills one
//! for the FIB of each switch, tiers one for each neighbouring domain, and whoever fills it sends
//! what [`Feed::next`] returns.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Bound::{Excluded, Included, Unbounded};
use std::time::Duration;

use gdp_proto::control::Extent;

/// How long after a push that failed the other side is sent the whole.
const RETRY: Duration = Duration::from_millis(500);

/// After so long the other side is told again what it took only a part of; each time in a row twice
/// as long, and at most this long.
const TELL_AGAIN: Duration = Duration::from_secs(60);
const TELL_AGAIN_AT_MOST: Duration = Duration::from_secs(16 * 60);

/// The desired entries of one other side, and how far it is known to hold them.
#[derive(Debug)]
pub struct Feed<K, V> {
    entries: BTreeMap<K, V>,
    /// Keys whose desired value is not what was last sent.
    dirty: BTreeSet<K>,
    generation: u64,
    phase: Phase<K>,
    /// Pushes that failed since one was answered.
    failures: u32,
    /// The push that has not been answered.
    in_flight: Option<InFlight<K>>,
    partly: Partly<K>,
}

/// What the other side took only a part of, and may take later, though nothing changes here: when
/// it has room.
#[derive(Debug)]
struct Partly<K> {
    /// Of all such pushes; which of them were refused is not said.
    keys: BTreeSet<K>,
    /// When they are told again.
    at: Option<Duration>,
    /// How often in a row they were.
    times: u32,
}

/// One push.
#[derive(Debug)]
pub struct Parcel<K, V> {
    pub generation: u64,
    pub extent: Extent,
    pub set: Vec<V>,
    pub remove: Vec<K>,
}

/// What one push takes.
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
    /// The other side gets the whole: next is this part, of what is behind this key.
    Full { part: u32, after: Option<K> },
    /// It holds everything but what is dirty.
    Following,
    /// A push failed; try again from this time on.
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
    /// Makes `value` the desired one of its key, or none.
    pub fn set(&mut self, key: K, value: Option<V>) {
        if self.entries.get(&key) != value.as_ref() {
            self.dirty.insert(key);
        }
        match value {
            Some(value) => self.entries.insert(key, value),
            None => self.entries.remove(&key),
        };
    }

    /// All that the other side should hold.
    pub fn entries(&self) -> &BTreeMap<K, V> {
        &self.entries
    }

    /// Sends the whole again. An answer that is still out no longer counts.
    pub fn restart(&mut self) {
        self.phase = Phase::Full { part: 0, after: None };
        self.in_flight = None;
        // All that is told with the whole.
        (self.partly.keys, self.partly.at) = (BTreeSet::new(), None);
    }

    /// The next push, unless one is out or there is nothing to say. `size`: bytes of an entry, or
    /// of a key that is removed. An empty push takes any one entry.
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
                // This page settles what is dirty on it; changes before it stay for a delta.
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

    /// What became of the push of this generation; whether it is the one that was out. If it
    /// failed, the whole is sent, a little later.
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

    /// As [`Self::answered`], of a push that was taken but for some of its entries: they are told
    /// again later.
    pub fn answered_partly(&mut self, now: Duration, generation: u64) {
        let Some(push) = self.in_flight.take_if(|push| push.generation == generation) else { return };
        self.failures = 0;
        self.partly.keys.extend(push.keys);
        let pause = TELL_AGAIN.saturating_mul(1 << self.partly.times.min(16)).min(TELL_AGAIN_AT_MOST);
        self.partly.at.get_or_insert(now + pause);
    }

    /// Whether the other side is known not to have taken all that it was told.
    pub fn lacks(&self) -> bool {
        self.partly.at.is_some()
    }

    /// Whether the other side has answered what there is to say of this key; or has failed to more
    /// than once, so that waiting is of no use.
    pub fn is_settled(&self, key: &K) -> bool {
        let sent = match &self.phase {
            Phase::Failed { .. } => return self.failures > 1,
            Phase::Following => true,
            Phase::Full { after, .. } => after.is_some_and(|after| *key <= after),
        };
        sent && !self.dirty.contains(key) && self.in_flight.as_ref().is_none_or(|push| !push.keys.contains(key))
    }

    /// The generation that the other side holds, while it is known to.
    pub fn acknowledged(&self) -> Option<u64> {
        (self.phase == Phase::Following && self.in_flight.is_none()).then_some(self.generation)
    }

    /// When to ask for the next push again, if nothing else happens.
    pub fn retry_at(&self) -> Option<Duration> {
        match self.phase {
            Phase::Failed { retry } => Some(retry),
            _ => self.partly.at,
        }
    }
}

/// What is left of a push.
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
