//! Times at which something is to be done, one for each key. Sans-IO: whoever has the clock asks.

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
    /// In place of the one that the key had; none: it has none any more.
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

    /// Takes out the earliest, if its time has come.
    pub fn take_due(&mut self, now: Duration) -> Option<K> {
        let (_, key) = self.at.first().copied().filter(|(at, _)| *at <= now)?;
        self.set(key, None);
        Some(key)
    }

    pub fn next(&self) -> Option<Duration> {
        self.at.first().map(|(at, _)| *at)
    }
}
