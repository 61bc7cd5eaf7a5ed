//! When frames went: a bounded sample, to tell from a report's echo how long the way there and back
//! was and what is still under way.

use std::collections::VecDeque;

use super::Position;

/// Samples kept. Frames that go within a 1024th of what is under way share one.
const MOST: usize = 2048;

/// A frame that went for the first time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sent {
    pub position: Position,
    pub at: u64,
    /// Bytes of the topic that had gone by then, this frame's included, repairs too.
    pub total: u64,
    /// How often the topic had nothing to send before.
    pub pauses: u64,
}

/// In the order of sending, which is that of positions.
#[derive(Debug, Default)]
pub struct SentLog(VecDeque<Sent>);

impl SentLog {
    /// `under_way`: bytes that no reader has told of yet.
    pub fn add(&mut self, sent: Sent, under_way: u64) {
        if let Some(last) = self.0.back() {
            let close = sent.total.saturating_sub(last.total) < under_way / (MOST as u64 / 2);
            if close && sent.pauses == last.pauses {
                return;
            }
        }
        if self.0.len() == MOST {
            self.0.pop_front();
        }
        self.0.push_back(sent);
    }

    /// The last sample at or before this position.
    pub fn find(&self, position: Position) -> Option<Sent> {
        let behind = self.0.partition_point(|sent| sent.position <= position);
        behind.checked_sub(1).and_then(|index| self.0.get(index).copied())
    }
}

#[cfg(test)]
#[path = "../../tests/unit/transport/sent_log.rs"]
mod tests;
