//! Counts the outcomes of calls, for the statistics.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use gdp_wire::Name;
use serde::Serialize;

use crate::config::{Side, What};
use crate::tally::{Tally, reasons};

reasons! {
    /// Why a call has no answer.
    pub enum Reason {
        /// Its server has left; it may have carried the request out.
        Left = "left",
        /// Its server said that it failed.
        Refused = "refused",
        /// Too many wait, here or at the server's proxy.
        Busy = "busy",
        /// The request or the answer is not of its type, or not of one that this proxy can convert.
        Unconvertible = "unconvertible",
        /// What the other proxy says, or a local client, is not what one sends.
        Malformed = "malformed",
        /// The server was another than the one that was described.
        Changed = "changed",
        /// The fabric did not take it.
        SendFailed = "send_failed",
        /// The local graph did not take the answer.
        Unanswered = "unanswered",
    }
}

/// Of one service or action in one direction.
#[derive(Default)]
pub struct CallCounters {
    calls: AtomicU64,
    answers: AtomicU64,
    pending: AtomicU64,
    servers: AtomicU64,
    events: AtomicU64,
    events_dropped: AtomicU64,
    failures: Tally<Reason>,
}

/// A call that waits, for as long as this lives.
pub struct Pending<'a>(&'a CallCounters);

impl Drop for Pending<'_> {
    fn drop(&mut self) {
        self.0.pending.fetch_sub(1, Relaxed);
    }
}

impl CallCounters {
    pub fn begun(&self) -> Pending<'_> {
        self.calls.fetch_add(1, Relaxed);
        self.pending.fetch_add(1, Relaxed);
        Pending(self)
    }

    pub fn answered(&self) {
        self.answers.fetch_add(1, Relaxed);
    }

    /// True for the first one for this reason.
    pub fn failed(&self, reason: Reason) -> bool {
        self.failures.add(reason, 1)
    }

    /// So many can be called.
    pub fn servers(&self, now: usize) {
        self.servers.store(now as u64, Relaxed);
    }

    pub fn events(&self, passed: u64, dropped: u64) {
        self.events.fetch_add(passed, Relaxed);
        self.events_dropped.fetch_add(dropped, Relaxed);
    }

    pub fn read(&self) -> CallsCounted {
        let of = |counter: &AtomicU64| counter.load(Relaxed);
        CallsCounted {
            calls: of(&self.calls),
            answers: of(&self.answers),
            pending: of(&self.pending),
            servers: of(&self.servers),
            events: of(&self.events),
            events_dropped: of(&self.events_dropped),
            failures: self.failures.read(),
        }
    }
}

/// One service or action, as the statistics file shows it.
#[derive(Serialize)]
pub struct CallStats {
    pub what: What,
    pub service: String,
    /// The ROS graph, as the configuration calls it.
    pub graph: String,
    /// ROS type, as that graph calls it; null while it is not known.
    #[serde(rename = "type")]
    pub kind: Option<String>,
    /// `up`, or what it waits for.
    pub status: String,
    pub direction: Side,
    pub name: Name,
    #[serde(flatten)]
    pub counted: CallsCounted,
}

/// What the counters say at one moment.
#[derive(Default, Serialize)]
pub struct CallsCounted {
    pub calls: u64,
    pub answers: u64,
    /// All reasons, also those that did not happen.
    pub failures: BTreeMap<&'static str, u64>,
    /// Calls that wait at this moment.
    pub pending: u64,
    /// Those that can be called at this moment: `out`, 1 if there is a local one; `in`, the proxies
    /// that have one.
    pub servers: u64,
    /// Of actions: messages of feedback and status that crossed.
    pub events: u64,
    /// Feedback that found no room, or came too late.
    pub events_dropped: u64,
}

#[cfg(test)]
#[path = "../../tests/unit/call/counters.rs"]
mod tests;
