//! Handshakes of peers that dialled: a bounded number at once, of all and of one address, and what
//! is counted of those that are turned away. Pure but for the tasks that it ends; the port calls
//! it.

use std::collections::VecDeque;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use parking_lot::{Mutex, MutexGuard};
use tokio::task::AbortHandle;
use tokio::time::Instant;

/// Handshakes at once. Beyond half of them, or half of the share of its address, a peer has to
/// prove that first, where it can: who sends as somebody else takes nothing of that one's share.
pub const MAX_HANDSHAKES: usize = 64;

/// Of these, from one address: a peer that never finishes its handshakes leaves room for others.
const MAX_HANDSHAKES_OF_ONE: usize = 16;

/// Younger ones do not give way: who means it needs a few round trips. It also bounds how fast they
/// are begun, and with that what QUIC keeps of those that were ended.
const MIN_AGE: Duration = Duration::from_millis(100);

/// What became of handshakes that got no link. Clones count together.
#[derive(Clone, Debug, Default)]
pub struct HandshakeCounters(Arc<Counters>);

#[derive(Debug, Default)]
struct Counters {
    challenged: AtomicU64,
    refused: AtomicU64,
    displaced: AtomicU64,
    failed: AtomicU64,
}

/// Handshakes of peers that dialled, since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HandshakeCounts {
    /// Their peers were asked to prove their addresses first, and nothing was kept of them. Who
    /// does so is taken then.
    pub challenged: u64,
    /// Ignored: too many were under way from one address, or too many had just begun.
    pub refused: u64,
    /// Ended unfinished, because they were the oldest and too many came.
    pub displaced: u64,
    /// Not finished in time, or in error.
    pub failed: u64,
}

impl HandshakeCounters {
    pub fn read(&self) -> HandshakeCounts {
        let Counters { challenged, refused, displaced, failed } = &*self.0;
        let [challenged, refused, displaced, failed] =
            [challenged, refused, displaced, failed].map(|count| count.load(Ordering::Relaxed));
        HandshakeCounts { challenged, refused, displaced, failed }
    }

    pub(super) fn count_failed(&self) {
        self.0.failed.fetch_add(1, Ordering::Relaxed);
    }
}

/// What to do with a handshake that begins.
#[derive(Debug)]
pub enum Verdict {
    /// Not even to answer it.
    Ignore,
    /// To have the peer prove its address, and to keep nothing.
    Challenge,
    /// It is counted as long as what is here lives.
    Start(Started),
}

/// Those that are under way at a port.
#[derive(Clone, Debug)]
pub struct Handshakes {
    running: Arc<Mutex<Running>>,
    counters: HandshakeCounters,
}

#[derive(Debug, Default)]
struct Running {
    /// Oldest first.
    entries: VecDeque<PendingHandshake>,
    begun: u64,
}

#[derive(Debug)]
struct PendingHandshake {
    number: u64,
    from: IpAddr,
    began: Instant,
    task: Option<AbortHandle>,
}

impl Handshakes {
    pub fn new(counters: HandshakeCounters) -> Self {
        Self { running: Arc::default(), counters }
    }

    /// `may_challenge`: whether the peer can be made to prove its address, and has not. Where all
    /// places are taken, the oldest gives way: who means it is done after a few round trips, who
    /// fills the places is not.
    pub fn admit(&self, now: Instant, from: IpAddr, may_challenge: bool) -> Verdict {
        let (mut running, counters) = (self.lock(), &self.counters.0);
        let of_one = running.entries.iter().filter(|entry| entry.from == from).count();
        if of_one >= MAX_HANDSHAKES_OF_ONE {
            counters.refused.fetch_add(1, Ordering::Relaxed);
            return Verdict::Ignore;
        }
        let is_crowded = running.entries.len() >= MAX_HANDSHAKES / 2 || of_one >= MAX_HANDSHAKES_OF_ONE / 2;
        if may_challenge && is_crowded {
            counters.challenged.fetch_add(1, Ordering::Relaxed);
            return Verdict::Challenge;
        }
        let mut displaced = None;
        if running.entries.len() >= MAX_HANDSHAKES {
            let Some(oldest) = running.entries.pop_front_if(|oldest| now.duration_since(oldest.began) >= MIN_AGE)
            else {
                counters.refused.fetch_add(1, Ordering::Relaxed);
                return Verdict::Ignore;
            };
            counters.displaced.fetch_add(1, Ordering::Relaxed);
            displaced = oldest.task;
        }
        running.begun += 1;
        let number = running.begun;
        running.entries.push_back(PendingHandshake { number, from, began: now, task: None });
        drop(running);
        // The end of a task may come back here.
        displaced.inspect(AbortHandle::abort);
        Verdict::Start(Started { of: self.clone(), number })
    }

    fn lock(&self) -> MutexGuard<'_, Running> {
        self.running.lock()
    }
}

/// A handshake that is counted as long as this lives.
#[derive(Debug)]
pub struct Started {
    of: Handshakes,
    number: u64,
}

impl Started {
    /// The calling task is what is ended if this gives way; at once, if it has done so.
    pub fn runs_as(&self, task: AbortHandle) {
        let mut running = self.of.lock();
        if let Some(entry) = running.entries.iter_mut().find(|entry| entry.number == self.number) {
            entry.task = Some(task);
            return;
        }
        drop(running);
        task.abort();
    }
}

impl Drop for Started {
    fn drop(&mut self) {
        self.of.lock().entries.retain(|entry| entry.number != self.number);
    }
}

#[cfg(test)]
#[path = "../../tests/unit/port/handshakes.rs"]
mod tests;
