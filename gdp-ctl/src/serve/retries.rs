//! What the RIB did not take of what other domains told, though it may later: when there is room, or what it contradicts has ended. It is
//! tried again after a time that grows with each attempt, a few at once. Sans-IO.

use std::collections::BTreeMap;
use std::time::Duration;

use gdp::control::RecordPlace;

use crate::deadlines::Deadlines;

/// After the first attempt, and after many.
const FIRST: Duration = Duration::from_secs(1);
const LONGEST: Duration = Duration::from_secs(60);

/// Places that are tried at once: each takes a few signatures. And the time between two such attempts.
const AT_ONCE: usize = 64;
const BETWEEN: Duration = Duration::from_secs(1);

#[derive(Debug, Default)]
pub struct Retries {
    due: Deadlines<RecordPlace>,
    /// How often each was refused, in a row.
    refused: BTreeMap<RecordPlace, u32>,
    not_before: Duration,
}

impl Retries {
    /// It was refused; how often by now, in a row.
    pub fn refused(&mut self, now: Duration, place: RecordPlace) -> u32 {
        let times = self.refused.entry(place).or_default();
        self.due.set(place, Some(now + FIRST.saturating_mul(1 << (*times).min(16)).min(LONGEST)));
        *times += 1;
        *times
    }

    /// It was taken, or nobody tells of it any more.
    pub fn settled(&mut self, place: &RecordPlace) {
        self.refused.remove(place);
        self.due.set(*place, None);
    }

    /// Those to be tried now: of each it is to be said what became of it.
    pub fn take_due(&mut self, now: Duration) -> Vec<RecordPlace> {
        if now < self.not_before {
            return Vec::new();
        }
        let due: Vec<_> = std::iter::from_fn(|| self.due.take_due(now)).take(AT_ONCE).collect();
        if !due.is_empty() {
            self.not_before = now + BETWEEN;
        }
        due
    }

    pub fn next_tick(&self) -> Option<Duration> {
        self.due.next().map(|at| at.max(self.not_before))
    }
}

#[cfg(test)]
mod tests {
    use gdp::control::NameRole;
    use gdp_wire::Name;

    use super::*;

    #[test]
    fn attempts_get_rarer_and_are_never_many_at_once() {
        let mut retries = Retries::default();
        let (mut now, mut waits) = (Duration::from_secs(100), vec![]);
        for times in 1..=10 {
            assert_eq!(retries.refused(now, place(0)), times);
            let next = retries.next_tick().unwrap();
            waits.push((next - now).as_secs());
            assert_eq!(retries.take_due(next - Duration::from_millis(1)), []);
            assert_eq!(retries.take_due(next), [place(0)]);
            assert_eq!(retries.next_tick(), None, "it is being tried");
            now = next;
        }
        assert_eq!(waits, [1, 2, 4, 8, 16, 32, 60, 60, 60, 60]);
        retries.settled(&place(0));
        assert_eq!(retries.refused(now, place(0)), 1, "it had been taken meanwhile");
        retries.settled(&place(0));

        (0..100).for_each(|i| _ = retries.refused(now, place(i)));
        now = retries.next_tick().unwrap();
        assert_eq!(retries.take_due(now).len(), AT_ONCE);
        assert_eq!(retries.take_due(now), []);
        assert_eq!(retries.next_tick(), Some(now + BETWEEN));
        assert_eq!(retries.take_due(now + BETWEEN).len(), 100 - AT_ONCE);
    }

    fn place(i: u8) -> RecordPlace {
        let name = Name::from_bytes([i; 32]);
        RecordPlace { name, role: NameRole::Publisher, entity: name, switch: name }
    }
}
