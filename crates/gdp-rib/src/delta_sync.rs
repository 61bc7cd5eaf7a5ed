//! Synchronises a remote copy of an ordered set: a full transfer in parts, then deltas. It is pure
//! state and knows neither values nor messages. The RIB keeps one for each switch's FIB, each
//! neighbouring domain and each stream of updates to an entity. The owner composes the messages and
//! states how far they reach.

use std::collections::BTreeMap;
use std::ops::Bound::{Excluded, Included, Unbounded};
use std::time::Duration;

/// How much of a set of keys `K` the receiver has been sent. `C` says what changed of an entry.
#[derive(Debug)]
pub struct DeltaSync<K, C = ()> {
    phase: Phase<K>,
    /// Entries that changed since they were sent. While parts of a full transfer are pending, it
    /// also contains changes behind the last part, which the next parts include.
    changed: BTreeMap<K, C>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase<K> {
    /// The receiver gets the full set. `part` is the number of the next part, which starts behind
    /// key `after`.
    Full { part: u32, after: Option<K> },
    /// The receiver has been sent every entry except the changed ones.
    Following,
    /// A message was lost. A full transfer starts at `retry`.
    Failed { retry: Duration },
}

/// The kind of the next message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NextMessage<K> {
    /// The next part of a full transfer, with the entries behind key `after`.
    Part { after: Option<K> },
    /// The changed entries.
    Delta,
}

/// A composed part of a full transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TransferPart {
    pub number: u32,
    pub is_last: bool,
}

impl<K, C> DeltaSync<K, C> {
    /// Returns the state of a receiver that has been sent nothing.
    pub fn new() -> Self {
        Self { phase: Phase::Full { part: 0, after: None }, changed: BTreeMap::new() }
    }

    /// Returns the state of a receiver that has been sent everything.
    pub fn following() -> Self {
        Self { phase: Phase::Following, changed: BTreeMap::new() }
    }

    /// Starts a full transfer.
    pub fn restart(&mut self) {
        self.phase = Phase::Full { part: 0, after: None };
    }

    /// Records that a message was lost. The owner [restarts](Self::restart) at `retry`.
    pub fn failed(&mut self, retry: Duration) {
        self.phase = Phase::Failed { retry };
    }

    /// Returns the time of the full transfer after a lost message.
    pub fn retry_at(&self) -> Option<Duration> {
        match self.phase {
            Phase::Failed { retry } => Some(retry),
            _ => None,
        }
    }

    /// Returns whether no part of a full transfer is pending, and no message was lost.
    pub fn is_following(&self) -> bool {
        matches!(self.phase, Phase::Following)
    }
}

impl<K: Ord + Copy, C: Ord> DeltaSync<K, C> {
    /// Marks an entry as changed. Of two changes of one entry, the greater one counts.
    pub fn change(&mut self, key: K, change: C) {
        match self.changed.get_mut(&key) {
            Some(marked) if *marked >= change => {}
            Some(marked) => *marked = change,
            None => _ = self.changed.insert(key, change),
        }
    }

    /// Returns the kind of the next message, or `None` if nothing is pending or a message was lost.
    pub fn next_message(&self) -> Option<NextMessage<K>> {
        match self.phase {
            Phase::Full { after, .. } => Some(NextMessage::Part { after }),
            Phase::Following => (!self.changed.is_empty()).then_some(NextMessage::Delta),
            Phase::Failed { .. } => None,
        }
    }

    /// Records that the next part was composed up to key `end`, or up to the last entry if `None`.
    ///
    /// The part covers all changes in its range. Changes of earlier parts wait for a delta.
    pub fn part_composed(&mut self, end: Option<K>) -> TransferPart {
        debug_assert!(matches!(self.phase, Phase::Full { .. }), "no part is pending");
        let (number, after) = match self.phase {
            Phase::Full { part, after } => (part, after),
            Phase::Following | Phase::Failed { .. } => (0, None),
        };
        let range = (after.map_or(Unbounded, Excluded), end.map_or(Unbounded, Included));
        self.changed.extract_if(range, |_, _| true).for_each(drop);
        self.phase = match end {
            Some(_) => Phase::Full { part: number + 1, after: end },
            None => Phase::Following,
        };
        TransferPart { number, is_last: end.is_none() }
    }

    /// Removes and returns the first changed entry, if it fits into the message.
    pub fn next_change(&mut self, fits: impl FnOnce(&K) -> bool) -> Option<(K, C)> {
        let first = self.changed.first_entry()?;
        fits(first.key()).then(|| first.remove_entry())
    }

    /// Returns whether entries changed since they were sent.
    pub fn has_changes(&self) -> bool {
        !self.changed.is_empty()
    }

    /// Returns whether the receiver has been sent the current value of this entry.
    pub fn is_sent(&self, key: &K) -> bool {
        let is_covered = match self.phase {
            Phase::Full { after, .. } => after.is_some_and(|after| *key <= after),
            Phase::Following => true,
            Phase::Failed { .. } => false,
        };
        is_covered && !self.changed.contains_key(key)
    }
}

#[cfg(test)]
#[path = "../tests/unit/delta_sync.rs"]
mod tests;
