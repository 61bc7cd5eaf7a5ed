//! Tracks which link states each neighbour still needs. Unacknowledged ones are sent again, and
//! those that the neighbour has sent itself are skipped. It stores only names of switches; the link
//! states are in [`super::database`].

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use gdp_proto::control::Flooded;
use gdp_wire::Name;

use super::database::Database;

/// Maximum number of unacknowledged batches per neighbour. New link states need not wait for
/// earlier acknowledgements.
const MOST_OUT: usize = 4;

/// Maximum size of the link states in one batch, in bytes. `STATE_SIZE` is the overhead of each. A
/// message has at most 64 KiB.
const BATCH_SIZE: usize = 48 * 1024;
const STATE_SIZE: usize = 200;

/// Delays before retransmission of a lost batch: the first, and the maximum to which it doubles.
const RETRY: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(5));

/// Link states to send to a neighbour.
#[derive(Clone, Debug)]
pub struct Batch {
    pub id: BatchId,
    pub states: Vec<Flooded>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct BatchId {
    pub link: u32,
    number: u64,
}

#[derive(Default)]
pub struct Flooding {
    links: BTreeMap<u32, PendingAcks>,
    number: u64,
}

/// The link states that one neighbour still needs.
struct PendingAcks {
    owed: BTreeSet<Name>,
    /// Batches that were sent and not acknowledged.
    out: BTreeMap<BatchId, Vec<Name>>,
    retry: Option<Duration>,
    wait: Duration,
}

impl Flooding {
    pub fn up<'a>(&mut self, link: u32, all: impl Iterator<Item = &'a Name>) {
        let desk = PendingAcks { owed: all.copied().collect(), out: BTreeMap::new(), retry: None, wait: RETRY.0 };
        self.links.insert(link, desk);
    }

    pub fn down(&mut self, link: u32) {
        self.links.remove(&link);
    }

    /// Schedules a switch's new link state for all neighbours.
    pub fn owe_all(&mut self, switch: Name) {
        for desk in self.links.values_mut() {
            desk.owed.insert(switch);
        }
    }

    /// Schedules a switch's link state for the neighbour on this link, which lacks the newest one.
    pub fn owe(&mut self, link: u32, switch: Name) {
        if let Some(desk) = self.links.get_mut(&link) {
            desk.owed.insert(switch);
        }
    }

    /// Unschedules a switch's link state for the neighbour on this link, which has the newest one.
    pub fn holds(&mut self, link: u32, switch: &Name) {
        if let Some(desk) = self.links.get_mut(&link) {
            desk.owed.remove(switch);
        }
    }

    /// Returns the batches to send now.
    pub fn next(&mut self, now: Duration, database: &Database) -> Vec<Batch> {
        let mut batches = Vec::new();
        for (link, desk) in &mut self.links {
            if desk.retry.is_some_and(|at| at > now) {
                continue;
            }
            desk.retry = None;
            while desk.out.len() < MOST_OUT && !desk.owed.is_empty() {
                let (states, names) = desk.page(now, database);
                if states.is_empty() {
                    continue;
                }
                self.number += 1;
                let id = BatchId { link: *link, number: self.number };
                desk.out.insert(id, names);
                batches.push(Batch { id, states });
            }
        }
        batches
    }

    pub fn answered(&mut self, now: Duration, batch: BatchId, arrived: bool) {
        let Some(desk) = self.links.get_mut(&batch.link) else { return };
        let Some(names) = desk.out.remove(&batch) else { return };
        if arrived {
            desk.wait = RETRY.0;
            return;
        }
        desk.owed.extend(names);
        desk.retry = Some(now + desk.wait);
        desk.wait = (desk.wait * 2).min(RETRY.1);
    }

    pub fn retry_at(&self) -> Option<Duration> {
        self.links.values().filter_map(|desk| desk.retry).min()
    }
}

impl PendingAcks {
    /// Removes as many scheduled switches as fit into a message. Skips those whose link states have
    /// expired since.
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
