//! Which publisher a message is of. A message names its publisher by a GID. That of rmw_zenoh is
//! the hash of the publisher's token. Other implementations choose one, so the session decides.

use std::collections::{BTreeMap, HashMap};

use gdp_ros_zenoh::{Attachment, Received};

use super::view::Seen;
use crate::graph::event::Key;

/// Bound on the chosen GIDs of one topic.
const MAX_CHOSEN: usize = 256;

/// The known publishers of a topic.
#[derive(Default)]
pub struct Publishers {
    pub by_key: BTreeMap<Key, Seen>,
    /// The keys of publishers that chose their GIDs.
    chosen: HashMap<Key, Key>,
    /// The last number of each publisher.
    last: BTreeMap<Key, i64>,
}

impl Publishers {
    /// Returns the publisher of a message.
    pub fn of(&mut self, received: &Received) -> Option<Key> {
        let gid = super::view::key(received.attachment.gid);
        if self.by_key.contains_key(&gid) {
            return Some(gid);
        }
        if let Some(key) = self.chosen.get(&gid) {
            return Some(*key);
        }
        let session = received.session.as_ref()?;
        let mut there = self.by_key.iter().filter(|(_, seen)| seen.session == *session).map(|(key, _)| *key);
        let key = there.next().filter(|_| there.next().is_none())?;
        if self.chosen.len() < MAX_CHOSEN {
            self.chosen.insert(gid, key);
        }
        Some(key)
    }

    /// Returns the only publisher of the topic.
    pub fn only(&self) -> Option<Key> {
        let mut keys = self.by_key.keys();
        keys.next().filter(|_| keys.next().is_none()).copied()
    }

    pub fn remove(&mut self, key: &Key) {
        self.by_key.remove(key);
        self.last.remove(key);
        self.chosen.retain(|_, chosen| chosen != key);
    }

    /// Records the number of a message that is not carried, so that it does not count as lost too.
    pub fn skip(&mut self, attachment: &Attachment) {
        let gid = super::view::key(attachment.gid);
        let key = if self.by_key.contains_key(&gid) { Some(gid) } else { self.chosen.get(&gid).copied() };
        if let Some(key) = key {
            self.lost(key, attachment.sequence);
        }
    }

    /// Returns how many messages of a publisher were lost before the one with this number.
    pub fn lost(&mut self, key: Key, sequence: i64) -> u64 {
        let last = self.last.insert(key, sequence);
        let lost = last.and_then(|last| sequence.checked_sub(last)).map_or(0, |step| step.saturating_sub(1));
        // A number far ahead is another publisher's, or hostile.
        u64::try_from(lost).ok().filter(|lost| *lost < 1_000_000).unwrap_or(0)
    }
}

#[cfg(test)]
#[path = "../../../tests/unit/graph/zenoh/publishers.rs"]
mod tests;
