//! Counts the messages that are lost on their way from a DDS writer.

use std::collections::HashMap;

use rustdds::{GUID, SequenceNumber};

/// The last sequence number of each writer.
#[derive(Default)]
pub(super) struct Gaps(HashMap<GUID, SequenceNumber>);

/// Bound on the writers whose gaps are counted. Beyond it all are forgotten, and the next gap of
/// each is missed.
const MAX_WRITERS: usize = 4096;

impl Gaps {
    /// Returns the number of messages between this one and the last of the same writer.
    pub fn before(&mut self, writer: GUID, sequence: SequenceNumber) -> u64 {
        if self.0.len() >= MAX_WRITERS && !self.0.contains_key(&writer) {
            self.0.clear();
        }
        let last = self.0.entry(writer).or_insert(sequence);
        let ahead = i64::from(sequence).saturating_sub(i64::from(*last));
        *last = sequence.max(*last);
        ahead.saturating_sub(1).try_into().unwrap_or(0)
    }
}

#[cfg(test)]
#[path = "../../tests/unit/ros2/gaps.rs"]
mod tests;
