//! No more messages a second of each publisher than are wanted.

use std::collections::HashMap;
use std::num::NonZeroU32;
use std::time::{Duration, Instant};

use crate::graph::Key;

pub struct Pace {
    period: Option<Duration>,
    /// When the next message of a publisher is wanted.
    due: HashMap<Option<Key>, Instant>,
}

impl Pace {
    pub fn new(max_hz: Option<NonZeroU32>) -> Self {
        Self { period: max_hz.map(|hz| Duration::from_secs(1) / hz.get()), due: HashMap::new() }
    }

    /// Whether a message that comes now is wanted.
    pub fn takes(&mut self, now: Instant, from: Option<Key>) -> bool {
        let Some(period) = self.period else { return true };
        let due = self.due.entry(from).or_insert(now);
        if now < *due {
            return false;
        }
        // A message that comes a little late does not shift all that follow.
        *due = if now - *due < period { *due + period } else { now + period };
        true
    }

    pub fn left(&mut self, key: Key) {
        self.due.remove(&Some(key));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_publisher_keeps_the_rate() {
        let mut pace = Pace::new(NonZeroU32::new(10));
        let start = Instant::now();
        let taken = |pace: &mut Pace, from| {
            (0..300).filter(|i| pace.takes(start + Duration::from_millis(i * 100 / 3), Some(from))).count()
        };
        let first = taken(&mut pace, 1);
        assert!((95..=101).contains(&first), "30 Hz for ten seconds: {first}");
        assert_eq!(taken(&mut pace, 2), first, "each for itself");
        assert!(pace.takes(start + Duration::from_secs(60), Some(1)), "after a pause at once");
        assert!(!pace.takes(start + Duration::from_millis(60_050), Some(1)));
        pace.left(1);
        assert!(pace.takes(start, Some(1)));
        assert!((0..9).all(|_| Pace::new(None).takes(start, None)));
    }
}
