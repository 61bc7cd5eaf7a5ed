//! The transmit counter of each link, shared by the planes: a link has one sequence, whichever plane sends. Where XDP
//! runs, this is the memory of its BPF map; otherwise it is ordinary memory. Only ever accessed atomically.

use std::io;
use std::os::fd::{AsFd, AsRawFd};
use std::ptr::NonNull;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use aya::maps::{Array, IterableMap, MapData};
use gdp_wire::table::{MAX_LINKS, link_index};

const BYTES: usize = MAX_LINKS as usize * size_of::<AtomicU64>();

/// Counters by link index. Clones share them.
#[derive(Clone)]
pub struct TxCounters(Arc<Memory>);

enum Memory {
    Own(Box<[AtomicU64]>),
    Mapped(Mapping),
}

impl TxCounters {
    /// Counters that no kernel plane shares.
    pub fn new() -> Self {
        Self(Arc::new(Memory::Own((0..MAX_LINKS).map(|_| AtomicU64::new(0)).collect())))
    }

    /// The memory of the BPF map. The mapping outlives the map's descriptor.
    pub fn map(map: Array<MapData, u64>) -> io::Result<Self> {
        if map.len() != MAX_LINKS {
            return Err(io::Error::other(format!("it has {} entries instead of {MAX_LINKS}", map.len())));
        }
        let fd = map.map().fd().as_fd().as_raw_fd();
        // SAFETY: a fresh mapping of a descriptor that is open; nothing existing is replaced.
        let address = unsafe {
            libc::mmap(std::ptr::null_mut(), BYTES, libc::PROT_READ | libc::PROT_WRITE, libc::MAP_SHARED, fd, 0)
        };
        match NonNull::new(address) {
            Some(start) if address != libc::MAP_FAILED => Ok(Self(Arc::new(Memory::Mapped(Mapping(start.cast()))))),
            _ => Err(io::Error::last_os_error()),
        }
    }

    /// The count for the next frame on link `id`: 1 for the first of a link.
    pub fn next(&self, id: u32) -> u32 {
        // Frames carry the low half.
        (self.slot(id).fetch_add(1, Ordering::Relaxed) as u32).wrapping_add(1)
    }

    /// How many frames have left by the link; a new one begins at 0.
    pub fn set(&self, id: u32, count: u64) {
        self.slot(id).store(count, Ordering::Relaxed);
    }

    fn slot(&self, id: u32) -> &AtomicU64 {
        let counters: &[AtomicU64] = match &*self.0 {
            Memory::Own(counters) => counters,
            Memory::Mapped(mapping) => mapping.counters(),
        };
        &counters[link_index(id) as usize]
    }
}

impl Default for TxCounters {
    fn default() -> Self {
        Self::new()
    }
}

struct Mapping(NonNull<AtomicU64>);

// SAFETY: the mapping belongs to this value, and all access to it is atomic.
unsafe impl Send for Mapping {}
// SAFETY: as above.
unsafe impl Sync for Mapping {}

impl Mapping {
    fn counters(&self) -> &[AtomicU64] {
        // SAFETY: `map` mapped MAX_LINKS words here, aligned to a page; they stay until `drop`.
        unsafe { std::slice::from_raw_parts(self.0.as_ptr(), MAX_LINKS as usize) }
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: the mapping that `map` made, unmapped once.
        unsafe { libc::munmap(self.0.as_ptr().cast(), BYTES) };
    }
}
