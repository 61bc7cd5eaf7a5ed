//! Frames from neighbours addressed to this node: errors about frames it forwarded, echo replies,
//! and probes that ended here. The threads of the userspace plane write them and the daemon reads
//! them. An array of atomics and a short queue bound the memory. A flood from one neighbour cannot
//! hide the notices of another.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};

use gdp_wire::table::{MAX_LINKS, link_index};
use gdp_wire::{Counter, ErrorCode, FrameType, Header, Name};
use parking_lot::{Mutex, MutexGuard};
use tokio::sync::Notify;

/// Maximum number of probes queued for the daemon.
const MAX_PROBES: usize = 64;

pub struct Notices {
    /// Indexed by link index.
    links: Box<[LinkNotices]>,
    /// Signals that an echo reply has arrived.
    answered: Notify,
    probes: Mutex<VecDeque<Punted>>,
    probed: Notify,
}

/// A probe that ended at this switch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Punted {
    /// Id of the ingress link.
    pub link: u32,
    /// Name whose route the probe traces.
    pub destination: Name,
    /// The switch that sent the probe.
    pub source: Name,
    pub egress_bits: u64,
    pub cookie: u64,
}

/// Notices received on one link.
#[derive(Default)]
struct LinkNotices {
    errors: [AtomicU64; ErrorCode::COUNT],
    /// Cookie of the latest echo reply.
    answer: AtomicU64,
}

impl Default for Notices {
    fn default() -> Self {
        Self {
            links: (0..MAX_LINKS).map(|_| LinkNotices::default()).collect(),
            answered: Notify::new(),
            probes: Mutex::default(),
            probed: Notify::new(),
        }
    }
}

impl Notices {
    /// Clears the notices of the link that previously had this index.
    pub fn begin(&self, id: u32) {
        let link = self.of(id);
        link.errors.iter().chain([&link.answer]).for_each(|word| word.store(0, Ordering::Relaxed));
    }

    /// Processes a frame addressed to this node, from the neighbour on link `id`. Returns the
    /// counter for the frame.
    pub fn take(&self, id: u32, header: &Header, payload: &[u8]) -> Counter {
        let link = self.of(id);
        if header.version_type == FrameType::Probe.first_byte() {
            return self.take_probe(id, header, payload);
        }
        if header.version_type == FrameType::Echo.first_byte() && header.egress_set == Header::ANSWERS {
            link.answer.store(header.egress_bits(), Ordering::Relaxed);
            self.answered.notify_waiters();
            return Counter::Notice;
        }
        match ErrorCode::from_number(header.egress_set) {
            Some(code) if header.version_type == FrameType::Error.first_byte() => {
                link.errors[code.index()].fetch_add(1, Ordering::Relaxed);
                Counter::Notice
            }
            _ => Counter::Unknown,
        }
    }

    fn take_probe(&self, link: u32, header: &Header, payload: &[u8]) -> Counter {
        let Some(cookie) = payload.first_chunk() else { return Counter::Truncated };
        let mut probes = self.probes();
        if probes.len() >= MAX_PROBES {
            return Counter::PuntLimit;
        }
        probes.push_back(Punted {
            link,
            destination: header.destination,
            source: header.source,
            egress_bits: header.egress_bits(),
            cookie: u64::from_be_bytes(*cookie),
        });
        self.probed.notify_one();
        Counter::Notice
    }

    /// Waits for the next probe that ended here and returns it. Only one task may wait.
    pub async fn probe(&self) -> Punted {
        loop {
            let next = self.probes().pop_front();
            match next {
                Some(probe) => return probe,
                None => self.probed.notified().await,
            }
        }
    }

    /// Waits until the latest echo reply on a link has this cookie.
    pub async fn answered_with(&self, id: u32, cookie: u64) {
        loop {
            let more = self.answered.notified();
            if self.answer(id) == cookie {
                return;
            }
            more.await;
        }
    }

    fn probes(&self) -> MutexGuard<'_, VecDeque<Punted>> {
        self.probes.lock()
    }

    /// Returns the errors received on a link, in the order of [`ErrorCode::ALL`].
    pub fn errors(&self, id: u32) -> [u64; ErrorCode::COUNT] {
        std::array::from_fn(|i| self.of(id).errors[i].load(Ordering::Relaxed))
    }

    /// Returns the cookie of the latest echo reply on a link; 0 before the first.
    pub fn answer(&self, id: u32) -> u64 {
        self.of(id).answer.load(Ordering::Relaxed)
    }

    fn of(&self, id: u32) -> &LinkNotices {
        &self.links[link_index(id) as usize]
    }
}

#[cfg(test)]
#[path = "../tests/unit/notices.rs"]
mod tests;
