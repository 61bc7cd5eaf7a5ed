//! Limits and counts the inbound handshakes of a port.
//!
//! The number of concurrent handshakes is bounded, in total and per address. No I/O: the port calls
//! this module, whose only side effect is to abort tasks.

use std::collections::VecDeque;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use parking_lot::{Mutex, MutexGuard};
use tokio::task::AbortHandle;
use tokio::time::Instant;

/// Maximum number of concurrent handshakes. Beyond half of them, or half of its address's share, a
/// peer must first prove its address, if possible. A sender with a spoofed address therefore uses
/// nothing of the real address's share.
pub const MAX_HANDSHAKES: usize = 64;

/// Maximum number of concurrent handshakes from one address. A peer that never finishes its
/// handshakes thus leaves capacity for others.
const MAX_HANDSHAKES_OF_ONE: usize = 16;

/// Minimum age of a handshake before a newer one displaces it: an honest peer needs a few round
/// trips. The age also bounds the rate of new handshakes, and with it QUIC's state for aborted
/// ones.
const MIN_AGE: Duration = Duration::from_millis(100);

/// Counters of handshakes that did not result in a link. Clones share the counters.
#[derive(Clone, Debug, Default)]
pub struct HandshakeCounters(Arc<Counters>);

#[derive(Debug, Default)]
struct Counters {
    challenged: AtomicU64,
    refused: AtomicU64,
    displaced: AtomicU64,
    failed: AtomicU64,
}

/// Counts of inbound handshakes since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HandshakeCounts {
    /// Peers that had to prove their addresses first. The port stores nothing about them, and
    /// admits those that respond.
    pub challenged: u64,
    /// Ignored handshakes: too many were in progress from one address, or too many had just
    /// started.
    pub refused: u64,
    /// Aborted handshakes: each was the oldest when too many were in progress.
    pub displaced: u64,
    /// Handshakes that failed or timed out.
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

/// The action for a new handshake.
#[derive(Debug)]
pub enum Verdict {
    /// Ignore it without an answer.
    Ignore,
    /// Let the peer prove its address, without storing state.
    Challenge,
    /// Start it. The handshake counts until the value is dropped.
    Start(Started),
}

/// The handshakes in progress at a port.
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

    /// Decides on a new handshake. `may_challenge` means that the peer can be made to prove its
    /// address and has not done so.
    ///
    /// At the limit, the new handshake displaces the oldest one. Honest peers finish after a few
    /// round trips; peers that exhaust the limit do not.
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
        // Aborting a task may re-enter this object.
        displaced.inspect(AbortHandle::abort);
        Verdict::Start(Started { of: self.clone(), number })
    }

    fn lock(&self) -> MutexGuard<'_, Running> {
        self.running.lock()
    }
}

/// A handshake that counts until this value is dropped.
#[derive(Debug)]
pub struct Started {
    of: Handshakes,
    number: u64,
}

impl Started {
    /// Sets the task to abort when this handshake is displaced. Aborts it at once if that has
    /// already happened.
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
