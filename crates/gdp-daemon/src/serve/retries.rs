//! Retries records of other domains that the RIB refused. Sans-IO.
//!
//! The RIB may accept a record later, when there is room or a conflicting record has ended. The
//! delay grows with each attempt. Each round retries a few records, in turn for each neighbour that
//! sent them. [`gdp_rib::tiers`] bounds the number of records per neighbour.

use std::collections::{BTreeMap, VecDeque};
use std::ops::Bound::{Excluded, Unbounded};
use std::time::Duration;

use gdp_proto::control::RecordKey;
use gdp_util::backoff::Backoff;
use gdp_wire::Name;

use gdp_rib::deadlines::Deadlines;

/// The maximum delay before a retry. [`RETRY`] starts at one second.
const LONGEST: Duration = Duration::from_secs(60);
const RETRY: Backoff = Backoff::new(Duration::from_secs(1), LONGEST);

/// The maximum number of records in one round, because each needs a few signature checks. `BETWEEN`
/// is the minimum time between two rounds.
const AT_ONCE: usize = 64;
const BETWEEN: Duration = Duration::from_secs(1);

#[derive(Debug, Default)]
pub struct Retries {
    /// The deadlines by neighbour, so that each has its turn regardless of the others.
    due: BTreeMap<Name, Deadlines<RecordKey>>,
    /// The neighbour that sent each record, and the number of refusals in a row.
    refused: BTreeMap<RecordKey, (Name, u32)>,
    not_before: Duration,
    /// The neighbour whose turn was last.
    last: Name,
}

impl Retries {
    /// Records a refusal of a record from `neighbour`. Returns the number of refusals in a row.
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

    /// Stops the retries of a record that was accepted or withdrawn.
    pub fn settled(&mut self, place: &RecordKey) {
        let Some((neighbour, _)) = self.refused.remove(place) else { return };
        if let Some(due) = self.due.get_mut(&neighbour) {
            due.set(*place, None);
        }
        self.drop_idle(&neighbour);
    }

    /// Returns the records to retry now, with equal shares for all neighbours. The caller must
    /// report each outcome.
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

    /// Drops a neighbour without pending retries.
    fn drop_idle(&mut self, neighbour: &Name) {
        if self.due.get(neighbour).is_some_and(|due| due.next().is_none()) {
            self.due.remove(neighbour);
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/serve/retries.rs"]
mod tests;
