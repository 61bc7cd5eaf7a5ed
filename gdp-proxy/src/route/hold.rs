//! What a new writer is given first waits until subscribers have found it: they do so within milliseconds of its making, or seconds where
//! the machine is busy, and a publisher of a single message has gone by then.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// How long a writer waits for a first subscriber; without one, nobody may want the topic. What is reliable is worth more patience than what
/// another message replaces.
const PATIENCE: Duration = Duration::from_millis(750);
const RELIABLE_PATIENCE: Duration = Duration::from_secs(3);

/// How long it waits for the others, and for the first one to know of it, too.
const SETTLE: Duration = Duration::from_millis(150);

/// Of one writer.
const MAX_WAITING: usize = 256;
const MAX_WAITING_BYTES: usize = 16 << 20;

/// `T`: a message.
pub struct Hold<T> {
    until: Instant,
    has_matched: bool,
    /// With its bytes, and those of all.
    waiting: VecDeque<(T, usize)>,
    bytes: usize,
}

impl<T> Hold<T> {
    pub fn new(now: Instant, is_reliable: bool) -> Self {
        let patience = if is_reliable { RELIABLE_PATIENCE } else { PATIENCE };
        Self { until: now + patience, has_matched: false, waiting: VecDeque::new(), bytes: 0 }
    }

    pub fn push(&mut self, message: T, bytes: usize) {
        self.waiting.push_back((message, bytes));
        self.bytes += bytes;
    }

    /// Of all that waits.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// How many bytes it is.
    pub fn drop_oldest(&mut self) -> usize {
        let bytes = self.waiting.pop_front().map_or(0, |(_, bytes)| bytes);
        self.bytes -= bytes;
        bytes
    }

    /// Whether nothing waits any longer. `is_matched`: the writer has a subscriber.
    pub fn is_over(&mut self, now: Instant, is_matched: impl FnOnce() -> bool) -> bool {
        if !self.has_matched && is_matched() {
            self.has_matched = true;
            self.until = self.until.min(now + SETTLE);
        }
        now >= self.until || self.waiting.len() > MAX_WAITING || self.bytes > MAX_WAITING_BYTES
    }

    pub fn into_waiting(self) -> impl Iterator<Item = T> {
        self.waiting.into_iter().map(|(message, _)| message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_waits_for_the_first_subscriber_and_no_longer_than_it_may() {
        let now = Instant::now();
        for (is_reliable, patience) in [(true, RELIABLE_PATIENCE), (false, PATIENCE)] {
            let mut hold = Hold::<u8>::new(now, is_reliable);
            assert!(!hold.is_over(now + patience - SETTLE / 2, || false) && hold.is_over(now + patience, || false));
        }
        let mut hold = Hold::new(now, false);
        hold.push('a', 1);
        assert!(!hold.is_over(now + SETTLE, || true) && !hold.is_over(now + SETTLE, || unreachable!("it is known")));
        assert!(hold.is_over(now + 2 * SETTLE, || true));
        assert_eq!(hold.into_waiting().collect::<Vec<_>>(), ['a']);
        let mut late = Hold::<u8>::new(now, false);
        assert!(!late.is_over(now + PATIENCE - SETTLE / 2, || true) && late.is_over(now + PATIENCE, || true));
    }

    #[test]
    fn what_waits_is_bounded() {
        let now = Instant::now();
        let (mut many, mut large) = (Hold::new(now, true), Hold::new(now, true));
        (0..=MAX_WAITING).for_each(|i| many.push(i, 1));
        large.push(0, MAX_WAITING_BYTES + 1);
        assert!(many.is_over(now, || false) && large.is_over(now, || false));
        assert_eq!((large.drop_oldest(), large.bytes(), large.drop_oldest()), (MAX_WAITING_BYTES + 1, 0, 0));
    }
}
