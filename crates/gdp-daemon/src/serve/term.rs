//! A leader's term of office: when it ends, and which of what has changed in it is stored. Who
//! waits for something to be stored has a ticket of the term in which it changed: of what a term
//! has left undone, another one stores nothing.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use gdp_proto::control::{Refusal, RefusalCode};
use parking_lot::Mutex;
use tokio::sync::{Notify, watch};
use tokio::time::{Instant, sleep_until, timeout};

use crate::store::StoreError;

/// How long what is stated waits to be stored.
const TIMEOUT: Duration = Duration::from_secs(4);

pub struct Term {
    ends: Mutex<Instant>,
    /// Tickets that were issued.
    issued: AtomicU64,
    /// Something is on its way to the store.
    is_writing: AtomicBool,
    wake: Notify,
    progress: watch::Sender<Progress>,
}

/// Of those that have a ticket.
#[derive(Clone, Debug, Default)]
struct Progress {
    done: u64,
    failed: u64,
    why: String,
}

/// For what has changed in a term until it was issued.
pub struct Ticket {
    term: Arc<Term>,
    number: u64,
}

impl Term {
    pub fn new(ends: Instant) -> Self {
        let (issued, is_writing) = (0.into(), false.into());
        Self { ends: Mutex::new(ends), issued, is_writing, wake: Notify::new(), progress: watch::Sender::default() }
    }

    pub fn is_over(&self) -> bool {
        Instant::now() >= *self.ends.lock()
    }

    /// Returns once it is over, whatever else is waited for.
    pub async fn over(&self) {
        while !self.is_over() {
            let ends = *self.ends.lock();
            sleep_until(ends).await;
        }
    }

    /// Has it last longer; not if it is over, as that may have been noticed. Whether it does.
    pub fn extend(&self, to: Instant) -> bool {
        let mut ends = self.ends.lock();
        let lasts = Instant::now() < *ends;
        if lasts {
            *ends = to;
        }
        lasts
    }

    /// It is over. To be called when no more tickets are issued: whoever has one is told why it is
    /// not stored.
    pub fn end(&self, why: &str) {
        *self.ends.lock() = Instant::now();
        self.failed(u64::MAX, why);
    }

    /// To be taken under the lock under which something has changed: then that is stored with, or
    /// before, what has a later ticket, and the term is still the one in which it changed.
    pub fn ticket(self: &Arc<Self>) -> Ticket {
        let number = self.issued.fetch_add(1, Ordering::AcqRel) + 1;
        Ticket { term: self.clone(), number }
    }

    /// The last ticket so far. To be asked under the same lock, when what has changed is collected.
    pub fn last_ticket(&self) -> u64 {
        self.issued.load(Ordering::Acquire)
    }

    /// Whether somebody waits who has this ticket or an earlier one.
    pub fn is_awaited(&self, last: u64) -> bool {
        self.progress.borrow().done < last
    }

    /// Returns when somebody waits, or after a while.
    pub async fn awaited(&self, at_most: Duration) {
        let _ = timeout(at_most, self.wake.notified()).await;
    }

    pub fn is_writing(&self) -> bool {
        self.is_writing.load(Ordering::Acquire)
    }

    pub fn set_writing(&self, is_writing: bool) {
        self.is_writing.store(is_writing, Ordering::Release);
    }

    /// All up to this ticket is stored.
    pub fn done(&self, last: u64) {
        self.progress.send_modify(|progress| progress.done = progress.done.max(last));
    }

    /// What is not stored of it is to be tried again by whoever stated it.
    pub fn failed(&self, last: u64, why: &str) {
        self.progress.send_modify(|progress| {
            (progress.failed, progress.why) = (progress.failed.max(last), why.into());
        });
    }
}

impl Ticket {
    /// Returns once it is stored; or that it is not, and why.
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

/// What comes of the work of a term, at its end at the latest.
pub async fn within(term: &Term, work: impl Future<Output = StoreError>) -> StoreError {
    tokio::select! {
        error = work => error,
        () = term.over() => StoreError::Fenced,
    }
}

#[cfg(test)]
#[path = "../../tests/unit/serve/term.rs"]
mod tests;
