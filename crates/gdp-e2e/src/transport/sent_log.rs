//! A bounded sample of send times. With the echo in a report, it gives the round-trip time and the
//! bytes in flight.

use std::collections::VecDeque;

use super::Position;

/// Maximum number of samples. Frames within a 1024th of the bytes in flight share one sample.
const MOST: usize = 2048;

/// The first transmission of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sent {
    pub position: Position,
    pub at: u64,
    /// Bytes of the topic sent up to then, including this frame and repairs.
    pub total: u64,
    /// Number of earlier times when the topic had nothing to send.
    pub pauses: u64,
}

/// Samples in the order of sending, which is the order of positions.
#[derive(Debug, Default)]
pub struct SentLog(VecDeque<Sent>);

impl SentLog {
    /// Adds a sample. `under_way` is the number of bytes that no reader has reported yet.
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

    /// Returns the last sample at or before this position.
    pub fn find(&self, position: Position) -> Option<Sent> {
        let behind = self.0.partition_point(|sent| sent.position <= position);
        behind.checked_sub(1).and_then(|index| self.0.get(index).copied())
    }

    /// Returns the position of the first sample that was sent later than this time.
    pub fn first_after(&self, at: u64) -> Option<Position> {
        self.0.get(self.0.partition_point(|sent| sent.at <= at)).map(|sent| sent.position)
    }
}

#[cfg(test)]
#[path = "../../tests/unit/transport/sent_log.rs"]
mod tests;
