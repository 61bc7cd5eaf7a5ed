//! When frames went: a bounded sample, to tell from a report's echo how long the way there and back was and what is still under way.

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
mod tests {
    use super::*;

    #[test]
    fn it_stays_bounded_and_finds_what_is_near() {
        let mut log = SentLog::default();
        let sent = |n: u64| Sent {
            position: Position { sequence: n / 10, index: (n % 10) as u32 },
            at: n,
            total: n * 1000,
            pauses: 0,
        };
        for n in 0..100_000 {
            log.add(sent(n), 5_000_000);
        }
        assert!(log.0.len() <= MOST);
        for n in 99_000..100_000 {
            let found = log.find(sent(n).position).unwrap();
            assert!(found.at <= n && n - found.at <= 5, "{n}: {found:?}");
        }
        assert_eq!(log.find(sent(5).position), None);
    }
}
