//! What the RIB did not take of what other domains told, though it may later: when there is room,
//! or what it contradicts has ended. It is tried again after a time that grows with each attempt, a
//! few at once, in turn of those that each neighbour told. There are no more of one neighbour than
//! [`gdp_rib::tiers`] keeps of it. Sans-IO.

use std::collections::{BTreeMap, VecDeque};
use std::ops::Bound::{Excluded, Unbounded};
use std::time::Duration;

use gdp_proto::control::RecordKey;
use gdp_util::backoff::Backoff;
use gdp_wire::Name;

use gdp_rib::deadlines::Deadlines;

/// After the first attempt, and after many.
const LONGEST: Duration = Duration::from_secs(60);
const RETRY: Backoff = Backoff::new(Duration::from_secs(1), LONGEST);

/// Places that are tried at once: each takes a few signatures. And the time between two such
/// attempts.
const AT_ONCE: usize = 64;
const BETWEEN: Duration = Duration::from_secs(1);

#[derive(Debug, Default)]
pub struct Retries {
    /// By the neighbour that told of them: each has its turn, whatever the others wait for.
    due: BTreeMap<Name, Deadlines<RecordKey>>,
    /// Who told of each, and how often it was refused in a row.
    refused: BTreeMap<RecordKey, (Name, u32)>,
    not_before: Duration,
    /// Whose turn was last.
    last: Name,
}

impl Retries {
    /// It was refused as `neighbour` told it; how often by now, in a row.
    pub fn refused(&mut self, now: Duration, neighbour: Name, place: RecordKey) -> u32 {
        let before =
            self.refused.get(&place).filter(|(sources_of, _)| *sources_of == neighbour).map(|(_, times)| *times);
        self.settled(&place);
        let times = before.unwrap_or(0);
        let at = now + RETRY.after(times + 1);
        self.due.entry(neighbour).or_default().set(place, Some(at));
        self.refused.insert(place, (neighbour, times + 1));
        times + 1
    }

    /// It was taken, or nobody tells of it any more.
    pub fn settled(&mut self, place: &RecordKey) {
        let Some((neighbour, _)) = self.refused.remove(place) else { return };
        if let Some(due) = self.due.get_mut(&neighbour) {
            due.set(*place, None);
        }
        self.drop_idle(&neighbour);
    }

    /// Those to be tried now, of each neighbour as many as of another: of each it is to be said
    /// what became of it.
    pub fn take_due(&mut self, now: Duration) -> Vec<RecordKey> {
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
#[path = "../../tests/unit/serve/retries.rs"]
mod tests;
