//! A leader's term: its end, and which of its changes are stored.
//!
//! A caller that waits for a change to be stored holds a ticket of the term in which it happened.
//! No later term stores the changes that an earlier one left unstored.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use gdp_proto::control::{Refusal, RefusalCode};
use gdp_rib::leadership::lease::Lease;
use parking_lot::Mutex;
use tokio::sync::{Notify, watch};
use tokio::time::{Instant, sleep_until, timeout};

use crate::store::StoreError;

/// The maximum wait of a ticket until its change is stored.
const TIMEOUT: Duration = Duration::from_secs(4);

pub struct Term {
    lease: Mutex<Lease<Instant>>,
    /// The number of issued tickets.
    issued: AtomicU64,
    /// Whether a write to the store is pending.
    is_writing: AtomicBool,
    wake: Notify,
    progress: watch::Sender<Progress>,
}

/// The tickets up to which changes are stored, or have failed.
#[derive(Clone, Debug, Default)]
struct Progress {
    done: u64,
    failed: u64,
    why: String,
}

/// A claim on the changes of a term up to the ticket's issue.
pub struct Ticket {
    term: Arc<Term>,
    number: u64,
}

impl Term {
    pub fn new(ends: Instant) -> Self {
        let (issued, is_writing) = (0.into(), false.into());
        Self {
            lease: Mutex::new(Lease::new(ends)),
            issued,
            is_writing,
            wake: Notify::new(),
            progress: watch::Sender::default(),
        }
    }

    pub fn is_over(&self) -> bool {
        self.lease.lock().is_over(Instant::now())
    }

    /// Waits until the term is over, even if it is extended meanwhile.
    pub async fn over(&self) {
        while !self.is_over() {
            let ends = self.lease.lock().ends();
            sleep_until(ends).await;
        }
    }

    /// Extends the term and returns true. Returns false if the term is already over, because other
    /// tasks may have acted on its end.
    pub fn extend(&self, to: Instant) -> bool {
        self.lease.lock().extend(Instant::now(), to)
    }

    /// Ends the term. The caller must issue no more tickets. Holders of tickets get `why` as the
    /// reason of the failure.
    pub fn end(&self, why: &str) {
        self.lease.lock().end(Instant::now());
        self.failed(u64::MAX, why);
    }

    /// Issues a ticket. The caller must hold the lock under which the change happened. The change
    /// is then stored no later than those of later tickets, and belongs to this term.
    pub fn ticket(self: &Arc<Self>) -> Ticket {
        let number = self.issued.fetch_add(1, Ordering::AcqRel) + 1;
        Ticket { term: self.clone(), number }
    }

    /// Returns the number of the last ticket. The caller must hold the same lock when it collects
    /// the changes.
    pub fn last_ticket(&self) -> u64 {
        self.issued.load(Ordering::Acquire)
    }

    /// Returns whether a ticket up to `last` is not stored yet.
    pub fn is_awaited(&self, last: u64) -> bool {
        self.progress.borrow().done < last
    }

    /// Waits until a ticket holder waits, or at most `at_most`.
    pub async fn awaited(&self, at_most: Duration) {
        let _ = timeout(at_most, self.wake.notified()).await;
    }

    pub fn is_writing(&self) -> bool {
        self.is_writing.load(Ordering::Acquire)
    }

    pub fn set_writing(&self, is_writing: bool) {
        self.is_writing.store(is_writing, Ordering::Release);
    }

    /// Records that all changes up to this ticket are stored.
    pub fn done(&self, last: u64) {
        self.progress.send_modify(|progress| progress.done = progress.done.max(last));
    }

    /// Records that the changes up to this ticket may not be stored. The clients that made them
    /// must retry.
    pub fn failed(&self, last: u64, why: &str) {
        self.progress.send_modify(|progress| {
            (progress.failed, progress.why) = (progress.failed.max(last), why.into());
        });
    }
}

impl Ticket {
    /// Waits until the change is stored. Fails with the reason if it is not.
    pub async fn stored(self) -> Result<(), Refusal> {
        let Self { term, number } = self;
        let mut progress = term.progress.subscribe();
        term.wake.notify_one();
        let settled = progress.wait_for(|progress| progress.done >= number || progress.failed >= number);
        let why = match timeout(TIMEOUT, settled).await {
            Ok(Ok(progress)) if progress.done >= number => return Ok(()),
            Ok(Ok(progress)) => progress.why.clone(),
            Ok(Err(_)) | Err(_) => "etcd takes too long".into(),
        };
        Err(Refusal::new(RefusalCode::Unreachable, format!("taken in, but not kept: {why}; try again in a moment")))
    }
}

/// Returns the error with which the work of a term ends. Stops the work at the end of the term.
pub async fn within(term: &Term, work: impl Future<Output = StoreError>) -> StoreError {
    tokio::select! {
        error = work => error,
        () = term.over() => StoreError::Fenced,
    }
}

#[cfg(test)]
#[path = "../../tests/unit/serve/term.rs"]
mod tests;
