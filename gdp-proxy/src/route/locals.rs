//! The local writers on behalf of all remote publishers of one topic.

use std::collections::{HashMap, VecDeque};
use std::time::{Duration, Instant};

use gdp_wire::Name;

use super::local::{Local, Made};
use gdp_ros::roster::{Change, Offer};

/// Bound on the remote publishers with a local writer. Further ones have none.
const MAX_LOCALS: usize = 512;

/// Bound in bytes on all histories and waiting messages of one topic together.
const MAX_BYTES: usize = 256 << 20;

/// Bound on the writers that stay for a moment after their publisher. Beyond it the oldest are
/// dropped at once.
const MAX_LEAVING: usize = 64;

/// Number of writers that may be created at once. The bound protects the ROS graph against a remote
/// proxy that changes its publishers with every message.
const BURST: u32 = MAX_LOCALS as u32;
/// Time after which one more writer may be created.
const PERIOD: Duration = Duration::from_millis(50);

/// The publisher that a local writer stands for. `None` stands for all writers that do not
/// distinguish their publishers.
pub type Whose = Option<(Name, u32)>;

pub struct Locals {
    by: HashMap<Whose, Local>,
    leaving: VecDeque<Made>,
    /// Waiting messages that were dropped with their writer since the last call of [`Self::trim`].
    abandoned: u64,
    budget: Budget,
}

struct Budget {
    left: u32,
    since: Instant,
}

impl Locals {
    pub fn new(now: Instant) -> Self {
        Self { by: HashMap::new(), leaving: VecDeque::new(), abandoned: 0, budget: Budget { left: BURST, since: now } }
    }

    pub fn get(&mut self, whose: &Whose) -> Option<&mut Local> {
        self.by.get_mut(whose)
    }

    pub fn insert(&mut self, whose: Whose, local: Local) {
        self.by.insert(whose, local);
    }

    /// Applies a change of a publisher. Returns false if there is no room for its writer.
    pub fn change(&mut self, now: Instant, change: Change) -> bool {
        let gone = match change {
            Change::Left { writer, number } => self.by.remove(&Some((writer, number))).and_then(Local::into_made),
            Change::Silent { writer, number } => {
                // Subscribers must see the publisher leave at once.
                self.by.get_mut(&Some((writer, number))).and_then(Local::silence);
                None
            }
            Change::Joined { writer, number, kind, definition, node, offers } => {
                let (whose, is_full) = (Some((writer, number)), self.by.len() >= MAX_LOCALS);
                match self.by.get_mut(&whose) {
                    Some(local) if local.is_made() && local.is_of(&kind, definition.as_ref(), &offers) => {
                        local.update(node, offers.depth);
                        None
                    }
                    Some(local) => local.renew(kind, definition, node, offers),
                    None if is_full => return false,
                    None => {
                        self.by.insert(whose, Local::new(kind, definition, node, offers));
                        None
                    }
                }
            }
        };
        if let Some(made) = gone.filter(|made| !made.is_over(now)) {
            made.writer.vacate();
            self.leaving.push_back(made);
        }
        while self.leaving.len() > MAX_LEAVING {
            self.abandoned += self.leaving.pop_front().map_or(0, Made::abandon);
        }
        true
    }

    /// Returns the writers to create now, as far as the budget allows.
    pub fn due(&mut self, now: Instant) -> Vec<Whose> {
        let due: Vec<Whose> = self.by.iter().filter(|(_, local)| local.is_due(now)).map(|(whose, _)| *whose).collect();
        due.into_iter().take_while(|_| self.budget.take(now)).collect()
    }

    /// Returns the publishers that have a local writer or wait for one.
    pub fn all(&mut self) -> impl Iterator<Item = (&Whose, &mut Local)> {
        self.by.iter_mut()
    }

    /// Returns all existing writers, including those that stay after their publisher.
    pub fn made(&mut self) -> impl Iterator<Item = &mut Made> {
        self.by.values_mut().filter_map(Local::made_mut).chain(&mut self.leaving)
    }

    pub fn is_busy(&mut self) -> bool {
        self.made().any(|made| made.is_holding())
    }

    /// Drops the oldest messages of the writer with the most bytes, until all together have at most
    /// [`MAX_BYTES`]. Returns the number of dropped messages, including those dropped with their
    /// writers.
    pub fn trim(&mut self) -> u64 {
        let bytes = self.by.values().map(Local::bytes).chain(self.leaving.iter().map(Made::bytes));
        let (mut bytes, mut gone): (usize, _) = (bytes.sum(), std::mem::take(&mut self.abandoned));
        while bytes > MAX_BYTES {
            let there = self.by.values_mut().max_by_key(|local| local.bytes());
            let leaving = self.leaving.iter_mut().max_by_key(|made| made.bytes());
            let freed = match (there, leaving) {
                (Some(there), Some(leaving)) if leaving.bytes() > there.bytes() => leaving.evict(),
                (Some(there), _) => there.evict(),
                (None, Some(leaving)) => leaving.evict(),
                (None, None) => 0,
            };
            (bytes, gone) = (bytes.saturating_sub(freed), gone + 1);
        }
        gone
    }

    /// Drops the writers that need not stay any longer after their publisher.
    pub fn sweep(&mut self, now: Instant) {
        self.leaving.retain(|made| !made.is_over(now));
    }

    /// Returns the offered QoS of each publisher that has a writer.
    pub fn offers(&mut self) -> impl Iterator<Item = (Whose, Offer)> {
        self.by.iter_mut().filter_map(|(whose, local)| Some((*whose, local.made_mut()?.offers)))
    }

    /// Whether a writer could not be created and no publisher has one.
    pub fn are_hopeless(&self) -> bool {
        self.faults().next().is_some() && !self.by.values().any(Local::is_made)
    }

    /// Returns the publishers without a writer, with the reason.
    pub fn faults(&self) -> impl Iterator<Item = (&Whose, &str)> {
        self.by.iter().filter_map(|(whose, local)| Some((whose, local.fault()?)))
    }
}

impl Budget {
    fn take(&mut self, now: Instant) -> bool {
        let periods = now.saturating_duration_since(self.since).as_millis() / PERIOD.as_millis();
        if periods > 0 {
            let more = u32::try_from(periods).unwrap_or(BURST);
            (self.left, self.since) = (self.left.saturating_add(more).min(BURST), now);
        }
        let may = self.left > 0;
        self.left -= u32::from(may);
        may
    }
}

#[cfg(test)]
#[path = "../../tests/unit/route/locals.rs"]
mod tests;
