//! Handshakes of peers that dialled: a bounded number at once, of all and of one address, and what is counted of those that are
//! turned away. Pure but for the tasks that it ends; the port calls it.

use std::collections::VecDeque;
use std::net::IpAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use tokio::task::AbortHandle;
use tokio::time::Instant;

/// Handshakes at once. Beyond half of them, or half of the share of its address, a peer has to prove that first, where it can: who sends
/// as somebody else takes nothing of that one's share.
pub const MAX_HANDSHAKES: usize = 64;

/// Of these, from one address: a peer that never finishes its handshakes leaves room for others.
const MAX_HANDSHAKES_OF_ONE: usize = 16;

/// Younger ones do not give way: who means it needs a few round trips. It also bounds how fast they are begun, and with that what QUIC
/// keeps of those that were ended.
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
    /// Their peers were asked to prove their addresses first, and nothing was kept of them. Who does so is taken then.
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
    entries: VecDeque<Entry>,
    begun: u64,
}

#[derive(Debug)]
struct Entry {
    number: u64,
    from: IpAddr,
    began: Instant,
    task: Option<AbortHandle>,
}

impl Handshakes {
    pub fn new(counters: HandshakeCounters) -> Self {
        Self { running: Arc::default(), counters }
    }

    /// `may_challenge`: whether the peer can be made to prove its address, and has not. Where all places are taken, the oldest gives
    /// way: who means it is done after a few round trips, who fills the places is not.
    pub fn judge(&self, now: Instant, from: IpAddr, may_challenge: bool) -> Verdict {
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
        running.entries.push_back(Entry { number, from, began: now, task: None });
        drop(running);
        // The end of a task may come back here.
        displaced.inspect(AbortHandle::abort);
        Verdict::Start(Started { of: self.clone(), number })
    }

    fn lock(&self) -> MutexGuard<'_, Running> {
        self.running.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
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
mod tests {
    use super::*;

    fn address(i: usize) -> IpAddr {
        IpAddr::from([10, 0, (i >> 8) as u8, i as u8])
    }

    fn start(handshakes: &Handshakes, now: Instant, i: usize) -> Started {
        match handshakes.judge(now, address(i), false) {
            Verdict::Start(started) => started,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn one_address_has_its_share_and_leaves_it_again() {
        let (handshakes, now) = (Handshakes::new(HandshakeCounters::default()), Instant::now());
        let half = MAX_HANDSHAKES_OF_ONE / 2;
        let mut of_one: Vec<_> = (0..half).map(|_| start(&handshakes, now, 1)).collect();
        assert!(
            matches!(handshakes.judge(now, address(1), true), Verdict::Challenge),
            "perhaps it is not of that address"
        );
        of_one.extend((half..MAX_HANDSHAKES_OF_ONE).map(|_| start(&handshakes, now, 1)));
        assert!(matches!(handshakes.judge(now, address(1), false), Verdict::Ignore));
        start(&handshakes, now, 2);
        of_one.pop();
        start(&handshakes, now, 1);
        assert_eq!(handshakes.counters.read(), HandshakeCounts { challenged: 1, refused: 1, ..Default::default() });
    }

    #[tokio::test]
    async fn beyond_half_addresses_are_to_be_proven_and_beyond_all_the_oldest_gives_way() {
        let (handshakes, now) = (Handshakes::new(HandshakeCounters::default()), Instant::now());
        let mut started: Vec<_> = (0..MAX_HANDSHAKES / 2).map(|i| start(&handshakes, now, i)).collect();
        assert!(matches!(handshakes.judge(now, address(1000), true), Verdict::Challenge));
        let oldest = tokio::spawn(std::future::pending::<()>());
        started[0].runs_as(oldest.abort_handle());
        started.extend((MAX_HANDSHAKES / 2..MAX_HANDSHAKES).map(|i| start(&handshakes, now, i)));
        assert!(matches!(handshakes.judge(now, address(1000), false), Verdict::Ignore), "the oldest is young");
        let now = now + MIN_AGE;
        started.push(start(&handshakes, now, 1000));
        assert!(oldest.await.is_err_and(|error| error.is_cancelled()));
        assert_eq!(handshakes.lock().entries.len(), MAX_HANDSHAKES);
        // One that has given way before it was known which task it is.
        started.push(start(&handshakes, now, 1001));
        let late = tokio::spawn(std::future::pending::<()>());
        started[1].runs_as(late.abort_handle());
        assert!(late.await.is_err());
        let counts = HandshakeCounts { challenged: 1, refused: 1, displaced: 2, failed: 0 };
        assert_eq!(handshakes.counters.read(), counts);
        drop(started);
        assert!(handshakes.lock().entries.is_empty());
    }
}
