//! Flooding state: which link states each neighbour still has to be sent, as in the retransmission
//! lists of OSPF. Unacknowledged batches are repeated. A link state received from a neighbour is
//! not sent back to it. Only names are tracked here; [`super::database`] holds the link states.
//!
//! There is no full transfer after a loss, unlike in [`crate::delta_sync`]: each link state has its
//! own version, so a lost batch concerns no other.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use gdp_proto::control::Flooded;
use gdp_util::backoff::Backoff;
use gdp_wire::Name;

use super::database::Database;

/// Maximum number of unacknowledged batches per neighbour. New statements need not wait for the
/// acknowledgement of earlier ones.
const MOST_OUT: usize = 4;

/// Bytes of the statements in one batch, and the overhead of each; a message has at most 64 KiB.
const BATCH_SIZE: usize = 48 * 1024;
const STATE_SIZE: usize = 200;

/// Delays before the next batch after lost ones.
const RETRY: Backoff = Backoff::new(Duration::from_millis(100), Duration::from_secs(5));

/// Batch of statements for one neighbour.
#[derive(Clone, Debug)]
pub struct Batch {
    pub id: BatchId,
    pub states: Vec<Flooded>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BatchId {
    pub link: u32,
    number: u64,
}

#[derive(Clone, Debug, Default)]
pub struct Flooding {
    links: BTreeMap<u32, PendingAcks>,
    number: u64,
}

/// Flooding state of one neighbour.
#[derive(Clone, Debug)]
struct PendingAcks {
    owed: BTreeSet<Name>,
    /// Batches in flight, with the switches whose statements they hold.
    out: BTreeMap<BatchId, Vec<Name>>,
    retry: Option<Duration>,
    backoff: Backoff,
}

impl Flooding {
    pub fn up<'a>(&mut self, link: u32, all: impl Iterator<Item = &'a Name>) {
        let neighbour = PendingAcks { owed: all.copied().collect(), out: BTreeMap::new(), retry: None, backoff: RETRY };
        self.links.insert(link, neighbour);
    }

    pub fn down(&mut self, link: u32) {
        self.links.remove(&link);
    }

    /// Marks the new statement of a switch for all neighbours.
    pub fn owe_all(&mut self, switch: Name) {
        for neighbour in self.links.values_mut() {
            neighbour.owed.insert(switch);
        }
    }

    /// Marks a switch for this neighbour, which has shown that it lacks the newest statement.
    pub fn owe(&mut self, link: u32, switch: Name) {
        if let Some(neighbour) = self.links.get_mut(&link) {
            neighbour.owed.insert(switch);
        }
    }

    /// Unmarks a switch for this neighbour, which has shown that it holds the newest statement.
    pub fn holds(&mut self, link: u32, switch: &Name) {
        if let Some(neighbour) = self.links.get_mut(&link) {
            neighbour.owed.remove(switch);
        }
    }

    /// Returns the batches to send now.
    pub fn next(&mut self, now: Duration, database: &Database) -> Vec<Batch> {
        let mut batches = Vec::new();
        for (link, neighbour) in &mut self.links {
            if neighbour.retry.is_some_and(|at| at > now) {
                continue;
            }
            neighbour.retry = None;
            while neighbour.out.len() < MOST_OUT && !neighbour.owed.is_empty() {
                let (states, names) = neighbour.page(now, database);
                if states.is_empty() {
                    continue;
                }
                self.number += 1;
                let id = BatchId { link: *link, number: self.number };
                neighbour.out.insert(id, names);
                batches.push(Batch { id, states });
            }
        }
        batches
    }

    pub fn answered(&mut self, now: Duration, batch: BatchId, arrived: bool) {
        let Some(neighbour) = self.links.get_mut(&batch.link) else { return };
        let Some(names) = neighbour.out.remove(&batch) else { return };
        if arrived {
            neighbour.backoff.reset();
            return;
        }
        neighbour.owed.extend(names);
        neighbour.retry = Some(now + neighbour.backoff.next_delay());
    }

    pub fn retry_at(&self) -> Option<Duration> {
        self.links.values().filter_map(|neighbour| neighbour.retry).min()
    }
}

impl PendingAcks {
    /// Removes as many marked switches as fit in a batch and returns their statements. Switches
    /// without a statement are dropped.
    fn page(&mut self, now: Duration, database: &Database) -> (Vec<Flooded>, Vec<Name>) {
        let (mut states, mut names, mut room) = (Vec::new(), Vec::new(), BATCH_SIZE);
        while let Some(switch) = self.owed.first().copied() {
            if let Some(flooded) = database.flooded(now, &switch) {
                let size = STATE_SIZE + flooded.state.as_bytes().len();
                if size > room {
                    break;
                }
                room -= size;
                states.push(flooded);
                names.push(switch);
            }
            self.owed.pop_first();
        }
        (states, names)
    }
}

#[cfg(test)]
#[path = "../../tests/unit/topology/flooding.rs"]
mod tests;
