//! No more messages a second of each publisher than are wanted; the newest of those between waits for its turn, so that the last one is not
//! lost.

use std::collections::HashMap;
use std::num::NonZeroU32;
use std::time::{Duration, Instant};

use crate::graph::Key;

/// `T`: a message.
pub struct Pace<T> {
    period: Option<Duration>,
    publishers: HashMap<Option<Key>, Turn<T>>,
}

struct Turn<T> {
    /// When the next message is wanted.
    due: Instant,
    /// The newest since the last that went.
    held: Option<T>,
}

impl<T> Pace<T> {
    pub fn new(max_hz: Option<NonZeroU32>) -> Self {
        Self { period: max_hz.map(|hz| Duration::from_secs(1) / hz.get()), publishers: HashMap::new() }
    }

    /// A message comes: what goes now, if anything does, and how many messages it takes the place of.
    pub fn take(&mut self, now: Instant, from: Option<Key>, message: T) -> (Option<T>, u64) {
        let Some(period) = self.period else { return (Some(message), 0) };
        let turn = self.publishers.entry(from).or_insert(Turn { due: now, held: None });
        let replaced = u64::from(turn.held.take().is_some());
        if now < turn.due {
            turn.held = Some(message);
            return (None, replaced);
        }
        // A message that comes a little late does not shift all that follow.
        turn.due = if now - turn.due < period { turn.due + period } else { now + period };
        (Some(message), replaced)
    }

    /// When something that is held is to go: half a period after its turn, for one that comes by itself soon after is newer.
    pub fn next(&self) -> Option<Instant> {
        let grace = self.period? / 2;
        self.publishers.values().filter(|turn| turn.held.is_some()).map(|turn| turn.due + grace).min()
    }

    /// What is held and is to go now; one for each call.
    pub fn overdue(&mut self, now: Instant) -> Option<T> {
        let period = self.period?;
        let waits = |turn: &&mut Turn<T>| turn.held.is_some() && now >= turn.due + period / 2;
        let turn = self.publishers.values_mut().find(waits)?;
        turn.due = now + period;
        turn.held.take()
    }

    /// What is held of a publisher that has gone.
    pub fn left(&mut self, key: Key) -> Option<T> {
        self.publishers.remove(&Some(key))?.held
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_publisher_keeps_the_rate() {
        let mut pace = Pace::new(NonZeroU32::new(10));
        let start = Instant::now();
        let taken = |pace: &mut Pace<u64>, from| {
            let goes = |i: &u64| pace.take(start + Duration::from_millis(i * 100 / 3), Some(from), *i).0.is_some();
            (0..300).filter(goes).count()
        };
        let first = taken(&mut pace, 1);
        assert!((95..=101).contains(&first), "30 Hz for ten seconds: {first}");
        assert_eq!(taken(&mut pace, 2), first, "each for itself");
        assert!(pace.take(start + Duration::from_secs(60), Some(1), 0).0.is_some(), "after a pause at once");
        assert!((0..9).all(|i| Pace::new(None).take(start, None, i) == (Some(i), 0)));
    }

    #[test]
    fn the_last_of_a_burst_goes_when_its_turn_has_come() {
        let (mut pace, start) = (Pace::new(NonZeroU32::new(10)), Instant::now());
        let at = |ms| start + Duration::from_millis(ms);
        assert_eq!(pace.take(at(0), Some(1), 'a'), (Some('a'), 0));
        assert_eq!(pace.next(), None);
        assert_eq!(pace.take(at(10), Some(1), 'b'), (None, 0));
        assert_eq!(pace.take(at(20), Some(1), 'c'), (None, 1));
        assert_eq!(pace.next(), Some(at(150)));
        assert_eq!((pace.overdue(at(149)), pace.overdue(at(150)), pace.overdue(at(150))), (None, Some('c'), None));
        assert_eq!(pace.take(at(200), Some(1), 'd'), (None, 0), "it went just now");
        assert_eq!(pace.take(at(260), Some(1), 'e'), (Some('e'), 1), "it came by itself, and is newer");
        pace.take(at(270), Some(1), 'f');
        assert_eq!((pace.left(1), pace.left(1), pace.next()), (Some('f'), None, None), "nothing comes after it");
    }
}
