//! Counts the outcomes of calls, for the statistics.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use gdp_wire::Name;
use serde::Serialize;

use crate::config::{Side, What};
use crate::tally::{Tally, reasons};
use crate::waiting::Waiting;

reasons! {
    /// Reasons for which a call has no answer.
    pub enum Reason {
        /// Its server has left and may have executed the request.
        Left = "left",
        /// Its server reported an error.
        Refused = "refused",
        /// Too many calls are pending, at this proxy or at the server's proxy.
        Busy = "busy",
        /// The request or the answer does not match its type, or the proxy cannot convert its type.
        Unconvertible = "unconvertible",
        /// The other proxy or a local client sent an invalid message.
        Malformed = "malformed",
        /// The server has changed since it was described.
        Changed = "changed",
        /// The fabric refused the message.
        SendFailed = "send_failed",
        /// The local graph refused the answer.
        Unanswered = "unanswered",
    }
}

/// Counters of one service or action in one direction.
#[derive(Default)]
pub struct CallCounters {
    calls: AtomicU64,
    answers: AtomicU64,
    pending: AtomicU64,
    servers: AtomicU64,
    calls_replicated: AtomicU64,
    copies_cancelled: AtomicU64,
    answers_by_other: AtomicU64,
    events: AtomicU64,
    events_dropped: AtomicU64,
    failures: Tally<Reason>,
}

/// A pending call, counted as pending until this is dropped.
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

    /// Counts a failure. Returns true for the first one with this reason.
    pub fn failed(&self, reason: Reason) -> bool {
        self.failures.add(reason, 1)
    }

    /// Sets the number of servers that can be called.
    pub fn servers(&self, now: usize) {
        self.servers.store(now as u64, Relaxed);
    }

    /// Counts a call that goes to several servers at once.
    pub fn replicated(&self) {
        self.calls_replicated.fetch_add(1, Relaxed);
    }

    pub fn copies_cancelled(&self, count: usize) {
        self.copies_cancelled.fetch_add(count as u64, Relaxed);
    }

    /// Counts an answer to a replicated call by another server than the nearest.
    pub fn answered_by_other(&self) {
        self.answers_by_other.fetch_add(1, Relaxed);
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
            calls_replicated: of(&self.calls_replicated),
            copies_cancelled: of(&self.copies_cancelled),
            answers_by_other: of(&self.answers_by_other),
            events: of(&self.events),
            events_dropped: of(&self.events_dropped),
            failures: self.failures.read(),
        }
    }
}

/// The statistics of one service or action, as the statistics file shows them.
#[derive(Serialize)]
pub struct CallStats {
    pub what: What,
    pub service: String,
    /// The ROS graph's name in the configuration.
    pub graph: String,
    /// The ROS type, as that graph writes it; null while it is unknown.
    #[serde(rename = "type")]
    pub kind: Option<String>,
    /// `up`, or the reason why not.
    pub status: String,
    /// What is missing for messages to flow; null if nothing is.
    pub waiting_for: Option<Waiting>,
    /// When the certificate ends, in Unix seconds; null if that is not known.
    pub certificate_until: Option<u64>,
    pub direction: Side,
    pub name: Name,
    #[serde(flatten)]
    pub counted: CallsCounted,
}

/// The values of the counters at one moment.
#[derive(Default, Serialize)]
pub struct CallsCounted {
    pub calls: u64,
    pub answers: u64,
    /// Failed calls by reason, with zero for reasons that did not occur.
    pub failures: BTreeMap<&'static str, u64>,
    /// Calls that are pending at this moment.
    pub pending: u64,
    /// Servers that can be called at this moment. `out`: 1 if there is a local server; `in`: the
    /// number of proxies that have one.
    pub servers: u64,
    /// `in`: calls that went to several servers at once (`replicate`).
    pub calls_replicated: u64,
    /// Calls whose answer was no longer needed. `in`: copies that this proxy cancelled; `out`:
    /// calls that a client cancelled before the local server answered.
    pub copies_cancelled: u64,
    /// `in`: replicated calls that another server than the nearest answered first.
    pub answers_by_other: u64,
    /// Feedback and status messages of actions that were carried.
    pub events: u64,
    /// Feedback messages that were dropped because they found no room or came too late.
    pub events_dropped: u64,
}

#[cfg(test)]
#[path = "../../tests/unit/call/counters.rs"]
mod tests;
