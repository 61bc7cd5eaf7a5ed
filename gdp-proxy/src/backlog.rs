//! What waits for the fabric while it is busy with an earlier message: bounded in messages and bytes, and when it is full
//! the oldest goes, as ROS 2's keep-last history does it.

use std::collections::VecDeque;

use bytes::Bytes;

/// Bytes of one topic that may wait, whatever the depth allows.
const MAX_BYTES: usize = 64 * 1024 * 1024;

pub struct Backlog {
    waiting: VecDeque<Bytes>,
    bytes: usize,
    depth: usize,
}

impl Backlog {
    /// At most `depth` messages, at least one.
    pub fn new(depth: usize) -> Self {
        Self { waiting: VecDeque::new(), bytes: 0, depth: depth.max(1) }
    }

    pub fn pop(&mut self) -> Option<Bytes> {
        let oldest = self.waiting.pop_front()?;
        self.bytes -= oldest.len();
        Some(oldest)
    }

    /// Adds the newest message; returns how many older ones had to go.
    pub fn push(&mut self, newest: Bytes) -> usize {
        let mut gone = 0;
        while self.waiting.len() == self.depth || !self.waiting.is_empty() && self.bytes + newest.len() > MAX_BYTES {
            self.pop();
            gone += 1;
        }
        self.bytes += newest.len();
        self.waiting.push_back(newest);
        gone
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_stay_and_in_order() {
        let mut backlog = Backlog::new(2);
        assert_eq!((backlog.push("1".into()), backlog.push("2".into()), backlog.push("3".into())), (0, 0, 1));
        assert_eq!((backlog.pop(), backlog.pop(), backlog.pop()), (Some("2".into()), Some("3".into()), None));
    }

    #[test]
    fn bytes_are_bounded_too_but_one_message_always_fits() {
        let mut backlog = Backlog::new(100);
        let half = Bytes::from(vec![0; MAX_BYTES / 2]);
        assert_eq!((backlog.push(half.clone()), backlog.push(half.clone()), backlog.push(half)), (0, 0, 1));
        assert_eq!(backlog.push(vec![0; MAX_BYTES + 1].into()), 2);
        assert_eq!(backlog.pop().unwrap().len(), MAX_BYTES + 1);
        assert_eq!(backlog.bytes, 0);
    }
}
