//! What changes with every frame of a link, shared by the planes: the count of frames sent and the replay window. A link has
//! one of each, whichever plane sends and receives. Where XDP runs, this is the memory of its BPF maps; otherwise it is
//! ordinary memory. Only ever accessed atomically.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use aya::maps::{Array, IterableMap, MapData};
use gdp_wire::replay::{WORDS, Window};
use gdp_wire::table::{MAX_LINKS, link_index};

use super::mapping::Mapping;

const LINKS: usize = MAX_LINKS as usize;

/// By link index. Clones share it.
#[derive(Clone)]
pub struct LinkMemory {
    counts: Arc<Memory>,
    windows: Arc<Memory>,
}

impl LinkMemory {
    /// Memory that no kernel plane shares.
    pub fn new() -> Self {
        Self { counts: Arc::new(Memory::own(LINKS)), windows: Arc::new(Memory::own(LINKS * WORDS)) }
    }

    /// The memory of the BPF maps. The mappings outlive the maps' descriptors.
    pub fn map(counts: &Array<MapData, u64>, windows: &Array<MapData, [u64; WORDS]>) -> io::Result<Self> {
        for length in [counts.len(), windows.len()] {
            if length != MAX_LINKS {
                return Err(io::Error::other(format!("a map has {length} entries instead of {MAX_LINKS}")));
            }
        }
        Ok(Self {
            counts: Arc::new(Memory::Mapped(Mapping::new(counts.map(), LINKS)?)),
            windows: Arc::new(Memory::Mapped(Mapping::new(windows.map(), LINKS * WORDS)?)),
        })
    }

    /// Forgets the link that had the index before. For a link that no plane takes frames from yet.
    pub fn begin(&self, id: u32) {
        self.set_count(id, 0);
        self.window(id).iter().for_each(|word| word.store(0, Ordering::Relaxed));
    }

    /// The count for the next frame on link `id`: 1 for the first of a link.
    pub fn next_count(&self, id: u32) -> u64 {
        self.count(id).fetch_add(1, Ordering::Relaxed).wrapping_add(1)
    }

    /// Says how many frames have left by the link.
    pub fn set_count(&self, id: u32, count: u64) {
        self.count(id).store(count, Ordering::Relaxed);
    }

    /// What has arrived on link `id`.
    pub fn window(&self, id: u32) -> &Window {
        let (windows, _) = self.windows.words().as_chunks();
        &windows[link_index(id) as usize]
    }

    fn count(&self, id: u32) -> &AtomicU64 {
        &self.counts.words()[link_index(id) as usize]
    }
}

impl Default for LinkMemory {
    fn default() -> Self {
        Self::new()
    }
}

enum Memory {
    Own(Box<[AtomicU64]>),
    Mapped(Mapping),
}

impl Memory {
    fn own(words: usize) -> Self {
        Self::Own((0..words).map(|_| AtomicU64::new(0)).collect())
    }

    fn words(&self) -> &[AtomicU64] {
        match self {
            Self::Own(words) => words,
            Self::Mapped(mapping) => mapping.as_ref(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gdp_wire::replay;

    #[test]
    fn links_have_memory_of_their_own_and_a_new_one_begins_with_nothing() {
        let memory = LinkMemory::new();
        let (a, b) = (0x1000_0001, 0x1000_0002);
        assert!(replay::take(memory.window(a), 5) && replay::take(memory.window(b), 5));
        assert_eq!((memory.next_count(a), memory.next_count(a), memory.next_count(b)), (1, 2, 1));
        let successor = a ^ 0x2000_0000;
        memory.begin(successor);
        assert_eq!(memory.next_count(successor), 1);
        assert!(replay::take(memory.window(successor), 5));
        assert!(!replay::take(memory.window(b), 5));
    }
}
