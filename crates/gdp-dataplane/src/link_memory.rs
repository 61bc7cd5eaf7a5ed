//! Per-link state that changes with every frame and that the planes share. For each link it
//! contains the count of frames sent and the replay window. It also contains the times of the last
//! error and of the last probe punted to the daemon. Each link has exactly one of each, regardless
//! of the plane that sends and receives. Where XDP runs, the state is the memory of BPF maps,
//! otherwise ordinary memory. All access is atomic.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use aya::maps::{Array, IterableMap, MapData};
use gdp_wire::replay::{WORDS, Window};
use gdp_wire::table::{COMPLAINT_INTERVAL_NS, MAX_LINKS, PUNT_INTERVAL_NS, link_index};

use super::mapping::Mapping;

const LINKS: usize = MAX_LINKS as usize;

/// Per-link state, indexed by link index. Clones share it.
#[derive(Clone)]
pub struct LinkMemory {
    counts: Arc<AtomicWords>,
    windows: Arc<AtomicWords>,
    complaints: Arc<AtomicWords>,
    punts: Arc<AtomicWords>,
}

/// The BPF maps that provide the memory.
pub struct LinkMaps<'a> {
    pub counts: &'a Array<MapData, u64>,
    pub windows: &'a Array<MapData, [u64; WORDS]>,
    pub complaints: &'a Array<MapData, u64>,
    pub punts: &'a Array<MapData, u64>,
}

impl LinkMemory {
    /// Returns memory that no kernel plane shares.
    pub fn new() -> Self {
        let own = |words| Arc::new(AtomicWords::own(words));
        Self { counts: own(LINKS), windows: own(LINKS * WORDS), complaints: own(LINKS), punts: own(LINKS) }
    }

    /// Maps the memory of the BPF maps. The mappings outlive the maps' descriptors.
    pub fn map(maps: LinkMaps<'_>) -> io::Result<Self> {
        let LinkMaps { counts, windows, complaints, punts } = maps;
        for length in [counts.len(), windows.len(), complaints.len(), punts.len()] {
            if length != MAX_LINKS {
                return Err(io::Error::other(format!("a map has {length} entries instead of {MAX_LINKS}")));
            }
        }
        let mapped = |map, words| Ok::<_, io::Error>(Arc::new(AtomicWords::Mapped(Mapping::new(map, words)?)));
        Ok(Self {
            counts: mapped(counts.map(), LINKS)?,
            windows: mapped(windows.map(), LINKS * WORDS)?,
            complaints: mapped(complaints.map(), LINKS)?,
            punts: mapped(punts.map(), LINKS)?,
        })
    }

    /// Clears the state of the link that previously had this index. No plane may receive frames on
    /// the new link yet.
    pub fn begin(&self, id: u32) {
        self.set_count(id, 0);
        self.forgive(id);
        self.window(id).iter().for_each(|word| word.store(0, Ordering::Relaxed));
    }

    /// Returns the sequence number for the next frame on link `id`: 1 for the first frame of a
    /// link.
    #[inline]
    pub fn next_count(&self, id: u32) -> u64 {
        self.next_counts(id, 1)
    }

    /// Reserves sequence numbers for `frames` consecutive frames on link `id`, and returns the
    /// first.
    #[inline]
    pub fn next_counts(&self, id: u32, frames: u64) -> u64 {
        self.count(id).fetch_add(frames, Ordering::Relaxed).wrapping_add(1)
    }

    /// Returns the number of frames sent on the link.
    pub fn sent(&self, id: u32) -> u64 {
        self.count(id).load(Ordering::Relaxed)
    }

    /// Sets the number of frames sent on the link.
    pub fn set_count(&self, id: u32, count: u64) {
        self.count(id).store(count, Ordering::Relaxed);
    }

    /// Returns the replay window of link `id`.
    #[inline]
    pub fn window(&self, id: u32) -> &Window {
        let (windows, _) = self.windows.words().as_chunks();
        &windows[link_index(id) as usize]
    }

    /// Returns whether the rate limit allows an error on the link now.
    pub fn may_send_error(&self, id: u32) -> bool {
        is_past(self.complaint(id), COMPLAINT_INTERVAL_NS)
    }

    /// Records that an error is sent now.
    pub fn send_error(&self, id: u32) {
        self.complaint(id).store(coarse_monotonic_ns(), Ordering::Relaxed);
    }

    /// Returns whether the rate limit allows punting a probe of the link to the daemon now.
    pub fn may_punt(&self, id: u32) -> bool {
        is_past(self.last_punt(id), PUNT_INTERVAL_NS)
    }

    /// Records that a probe is punted now.
    pub fn punt(&self, id: u32) {
        self.last_punt(id).store(coarse_monotonic_ns(), Ordering::Relaxed);
    }

    /// Resets both rate limits, so that the next error and the next probe are allowed immediately.
    pub fn forgive(&self, id: u32) {
        self.complaint(id).store(0, Ordering::Relaxed);
        self.last_punt(id).store(0, Ordering::Relaxed);
    }

    fn complaint(&self, id: u32) -> &AtomicU64 {
        &self.complaints.words()[link_index(id) as usize]
    }

    fn last_punt(&self, id: u32) -> &AtomicU64 {
        &self.punts.words()[link_index(id) as usize]
    }

    #[inline]
    fn count(&self, id: u32) -> &AtomicU64 {
        &self.counts.words()[link_index(id) as usize]
    }
}

impl Default for LinkMemory {
    fn default() -> Self {
        Self::new()
    }
}

/// Returns whether `interval` has passed since `last`.
fn is_past(last: &AtomicU64, interval: u64) -> bool {
    coarse_monotonic_ns().wrapping_sub(last.load(Ordering::Relaxed)) >= interval
}

/// Reads the clock that the XDP programs use.
fn coarse_monotonic_ns() -> u64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the structure outlives the call.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC_COARSE, &raw mut time) };
    time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
}

enum AtomicWords {
    Own(Box<[AtomicU64]>),
    Mapped(Mapping),
}

impl AtomicWords {
    fn own(words: usize) -> Self {
        Self::Own((0..words).map(|_| AtomicU64::new(0)).collect())
    }

    #[inline]
    fn words(&self) -> &[AtomicU64] {
        match self {
            Self::Own(words) => words,
            Self::Mapped(mapping) => mapping.as_ref(),
        }
    }
}

#[cfg(test)]
#[path = "../tests/unit/link_memory.rs"]
mod tests;
