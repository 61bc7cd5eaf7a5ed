//! What the RIB did not take of what other domains told, though it may later: when there is room, or what it contradicts has ended. It is
//! tried again after a time that grows with each attempt, a few at once, in turn of those that each neighbour told. There are no more of
//! one neighbour than [`gdp_rib::tiers`] keeps of it. Sans-IO.

use std::collections::{BTreeMap, VecDeque};
use std::ops::Bound::{Excluded, Unbounded};
use std::time::Duration;

use gdp_proto::control::RecordPlace;
use gdp_util::backoff::Backoff;
use gdp_wire::Name;

use gdp_rib::deadlines::Deadlines;

/// After the first attempt, and after many.
const LONGEST: Duration = Duration::from_secs(60);
const RETRY: Backoff = Backoff::new(Duration::from_secs(1), LONGEST);

/// Places that are tried at once: each takes a few signatures. And the time between two such attempts.
const AT_ONCE: usize = 64;
const BETWEEN: Duration = Duration::from_secs(1);

#[derive(Debug, Default)]
pub struct Retries {
    /// By the neighbour that told of them: each has its turn, whatever the others wait for.
    due: BTreeMap<Name, Deadlines<RecordPlace>>,
    /// Who told of each, and how often it was refused in a row.
    refused: BTreeMap<RecordPlace, (Name, u32)>,
    not_before: Duration,
    /// Whose turn was last.
    last: Name,
}

impl Retries {
    /// It was refused as `neighbour` told it; how often by now, in a row.
    pub fn refused(&mut self, now: Duration, neighbour: Name, place: RecordPlace) -> u32 {
        let before = self.refused.get(&place).filter(|(told_by, _)| *told_by == neighbour).map(|(_, times)| *times);
        self.settled(&place);
        let times = before.unwrap_or(0);
        let at = now + RETRY.after(times + 1);
        self.due.entry(neighbour).or_default().set(place, Some(at));
        self.refused.insert(place, (neighbour, times + 1));
        times + 1
    }

    /// It was taken, or nobody tells of it any more.
    pub fn settled(&mut self, place: &RecordPlace) {
        let Some((neighbour, _)) = self.refused.remove(place) else { return };
        if let Some(due) = self.due.get_mut(&neighbour) {
            due.set(*place, None);
        }
        self.drop_idle(&neighbour);
    }

    /// Those to be tried now, of each neighbour as many as of another: of each it is to be said what became of it.
    pub fn take_due(&mut self, now: Duration) -> Vec<RecordPlace> {
        if now < self.not_before {
            return Vec::new();
        }
        let after = (Excluded(self.last), Unbounded);
        let mut turns: VecDeque<Name> =
            self.due.range(after).chain(self.due.range(..=self.last)).map(|(neighbour, _)| *neighbour).collect();
        let mut taken = Vec::new();
        while taken.len() < AT_ONCE
            && let Some(neighbour) = turns.pop_front()
        {
            if let Some(place) = self.due.get_mut(&neighbour).and_then(|due| due.take_due(now)) {
                taken.push(place);
                turns.push_back(neighbour);
                self.last = neighbour;
            }
            self.drop_idle(&neighbour);
        }
        if !taken.is_empty() {
            self.not_before = now + BETWEEN;
        }
        taken
    }

    pub fn next_tick(&self) -> Option<Duration> {
        let next = self.due.values().filter_map(Deadlines::next).min();
        next.map(|at| at.max(self.not_before))
    }

    /// Keeps nothing of a neighbour of which nothing is to be tried.
    fn drop_idle(&mut self, neighbour: &Name) {
        if self.due.get(neighbour).is_some_and(|due| due.next().is_none()) {
            self.due.remove(neighbour);
        }
    }
}

#[cfg(test)]
mod tests {
    use gdp_proto::control::NameRole;

    use super::*;

    #[test]
    fn attempts_get_rarer_and_are_never_many_at_once() {
        let (mut retries, one) = (Retries::default(), neighbour(1));
        let (mut now, mut waits) = (Duration::from_secs(100), vec![]);
        for times in 1..=10 {
            assert_eq!(retries.refused(now, one, place(0)), times);
            let next = retries.next_tick().unwrap();
            waits.push((next - now).as_secs());
            assert_eq!(retries.take_due(next - Duration::from_millis(1)), []);
            assert_eq!(retries.take_due(next), [place(0)]);
            assert_eq!(retries.next_tick(), None, "it is being tried");
            now = next;
        }
        assert_eq!(waits, [1, 2, 4, 8, 16, 32, 60, 60, 60, 60]);
        retries.settled(&place(0));
        assert_eq!(retries.refused(now, one, place(0)), 1, "it had been taken meanwhile");
        retries.settled(&place(0));

        (0..100).for_each(|i| _ = retries.refused(now, one, place(i)));
        now = retries.next_tick().unwrap();
        assert_eq!(retries.take_due(now).len(), AT_ONCE);
        assert_eq!(retries.take_due(now), []);
        assert_eq!(retries.next_tick(), Some(now + BETWEEN));
        assert_eq!(retries.take_due(now + BETWEEN).len(), 100 - AT_ONCE);
    }

    #[test]
    fn no_neighbour_waits_for_what_others_told() {
        let (mut retries, mut now) = (Retries::default(), Duration::from_secs(100));
        let [many, few, third] = [1, 2, 3].map(neighbour);
        // Whoever comes first in any order, by time or by name.
        for i in 0..250 {
            retries.refused(now, many, place(i));
        }
        now += BETWEEN;
        [few, third].iter().zip(250..).for_each(|(other, i)| _ = retries.refused(now, *other, place(i)));
        now += BETWEEN;
        let taken = retries.take_due(now);
        assert!(taken.len() == AT_ONCE && [250, 251].iter().all(|i| taken.contains(&place(*i))), "{taken:?}");
        taken.iter().for_each(|place| retries.settled(place));
        for neighbour in [few, third] {
            (0..40).for_each(|i| _ = retries.refused(now, neighbour, RecordPlace { switch: neighbour, ..place(i) }));
        }
        now += BETWEEN;
        let taken = retries.take_due(now);
        let of = |neighbour| taken.iter().filter(|place| place.switch == neighbour).count();
        let shares = [of(few), of(third), taken.len() - of(few) - of(third)];
        assert!(shares.iter().all(|share| [21, 22].contains(share)), "{shares:?}");
    }

    #[test]
    fn a_place_waits_as_the_last_neighbour_told_it() {
        let (mut retries, now) = (Retries::default(), Duration::from_secs(100));
        let [one, other] = [1, 2].map(neighbour);
        assert_eq!([retries.refused(now, one, place(0)), retries.refused(now, one, place(0))], [1, 2]);
        assert_eq!(retries.refused(now, other, place(0)), 1, "another's word");
        assert_eq!(retries.take_due(now + LONGEST), [place(0)]);
        retries.settled(&place(0));
        assert_eq!((retries.next_tick(), retries.due.len(), retries.refused.len()), (None, 0, 0));
    }

    fn neighbour(i: u8) -> Name {
        Name::from_bytes([i; 32])
    }

    fn place(i: u8) -> RecordPlace {
        let name = Name::from_bytes([i; 32]);
        RecordPlace { name, role: NameRole::Publisher, entity: name, switch: name }
    }
}
