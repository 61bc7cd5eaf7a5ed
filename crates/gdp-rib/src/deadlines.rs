//! One deadline for each key, without I/O. The owner of the clock polls it.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

#[derive(Debug)]
pub struct Deadlines<K> {
    at: BTreeSet<(Duration, K)>,
    of: BTreeMap<K, Duration>,
}

impl<K> Default for Deadlines<K> {
    fn default() -> Self {
        Self { at: BTreeSet::new(), of: BTreeMap::new() }
    }
}

impl<K: Ord + Copy> Deadlines<K> {
    /// Replaces the deadline of `key`, or removes it if `at` is `None`.
    pub fn set(&mut self, key: K, at: Option<Duration>) {
        let before = match at {
            Some(at) => self.of.insert(key, at),
            None => self.of.remove(&key),
        };
        if let Some(before) = before {
            self.at.remove(&(before, key));
        }
        if let Some(at) = at {
            self.at.insert((at, key));
        }
    }

    /// Removes the earliest deadline and returns its key, if that deadline has passed.
    pub fn take_due(&mut self, now: Duration) -> Option<K> {
        let (_, key) = self.at.first().copied().filter(|(at, _)| *at <= now)?;
        self.set(key, None);
        Some(key)
    }

    pub fn next(&self) -> Option<Duration> {
        self.at.first().map(|(at, _)| *at)
    }
}
