//! What the receiving thread shares with the application's handle of a subscription: the bytes in
//! its queue, and its counters.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};

use super::counters::SubscriptionCounters;
use super::sink::DirectPath;
use gdp_e2e::seal::DropReason;
use gdp_e2e::transport::InboundCounters;

/// The state that the application's handle shares with the thread.
#[derive(Default)]
pub struct QueueState {
    pub queued_bytes: AtomicUsize,
    /// Whether messages of a reliable name wait for space in the queue.
    pub stalled: AtomicBool,
    /// Number of writers that offer less than the reader requests.
    pub incompatible: AtomicUsize,
    pub counters: ReadCounters,
    /// The path of messages past the queue.
    pub direct: DirectPath,
}

impl QueueState {
    pub fn counters(&self) -> SubscriptionCounters {
        let counters = &self.counters;
        SubscriptionCounters {
            inbound: counters.get(),
            queue_full: counters.queue_full.load(Ordering::Relaxed),
            repeats: counters.repeats.load(Ordering::Relaxed),
            incompatible_writers: self.incompatible.load(Ordering::Relaxed),
            drops: counters.drops(),
        }
    }
}

/// The counters of a name's messages at this reader. The writers' messages since the Welcome of
/// each are the sum of the first four and of those in progress.
#[derive(Default)]
pub struct ReadCounters {
    delivered: AtomicU64,
    overtaken: AtomicU64,
    expired: AtomicU64,
    abandoned: AtomicU64,
    duplicates: AtomicU64,
    beyond: AtomicU64,
    /// Delivered messages that the application did not receive in time.
    pub queue_full: AtomicU64,
    /// Delivered latched messages that this reader already had.
    pub repeats: AtomicU64,
    /// Segments and messages that the reader dropped, by [`DropReason`].
    dropped: [AtomicU64; DropReason::COUNT],
}

impl ReadCounters {
    pub fn dropped(&self, reason: DropReason, times: u64) {
        self.dropped[reason as usize].fetch_add(times, Ordering::Relaxed);
    }

    /// Returns the counts that are not 0.
    pub fn drops(&self) -> BTreeMap<&'static str, u64> {
        let counts = self.dropped.iter().map(|count| count.load(Ordering::Relaxed));
        DropReason::ALL.iter().map(|reason| reason.label()).zip(counts).filter(|(_, count)| *count > 0).collect()
    }

    pub fn get(&self) -> InboundCounters {
        let get = |count: &AtomicU64| count.load(Ordering::Relaxed);
        InboundCounters {
            delivered: get(&self.delivered),
            overtaken: get(&self.overtaken),
            expired: get(&self.expired),
            abandoned: get(&self.abandoned),
            duplicates: get(&self.duplicates),
            beyond: get(&self.beyond),
        }
    }

    pub fn add(&self, now: &InboundCounters, seen: &mut InboundCounters) {
        let all = [
            (&self.delivered, now.delivered, seen.delivered),
            (&self.overtaken, now.overtaken, seen.overtaken),
            (&self.expired, now.expired, seen.expired),
            (&self.abandoned, now.abandoned, seen.abandoned),
            (&self.duplicates, now.duplicates, seen.duplicates),
            (&self.beyond, now.beyond, seen.beyond),
        ];
        for (count, now, seen) in all {
            if now != seen {
                count.fetch_add(now - seen, Ordering::Relaxed);
            }
        }
        *seen = *now;
    }
}
