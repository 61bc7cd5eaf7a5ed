//! Where names and egress bits lead. Written by user space only.
//!
//! `FIB` holds one flat table (`gdp_wire::flat`, which says what a reader may meet), in an array that user space maps and writes while
//! programs read. To grow, user space fills another array and puts it in the place of the first: a program runs to its end on
//! the one that it began with. `NEXT_HOP` is one word per egress bit.
//!
//! `PERMITS` is a set: only whether a key is there counts. Few names have more than one writer at a switch, so its elements are
//! allocated as they are needed. A permit is there before the entry that says to look for it, and goes after.

use aya_ebpf::bindings::{BPF_F_INNER_MAP, BPF_F_MMAPABLE, BPF_F_NO_PREALLOC};
use aya_ebpf::btf_maps::{Array as BtfArray, ArrayOfMaps};
use aya_ebpf::macros::{btf_map, map};
use aya_ebpf::maps::{Array, HashMap};
use gdp_wire::flat::{self, BUCKET};
use gdp_wire::table::EGRESS_SET_SIZE;
use gdp_wire::{FibEntry, LinkEntry, Name, Permit};

/// Tables differ in size, which only `BPF_F_INNER_MAP` allows.
type Table = BtfArray<[u64; BUCKET], 1, { (BPF_F_MMAPABLE | BPF_F_INNER_MAP) as usize }>;

#[btf_map]
static FIB: ArrayOfMaps<Table, 1> = ArrayOfMaps::new();

/// The values say nothing. As many as there may be names.
#[map]
static PERMITS: HashMap<Permit, u32> = HashMap::with_max_entries(1024, BPF_F_NO_PREALLOC);

#[map]
static NEXT_HOP: Array<u32> = Array::with_max_entries(EGRESS_SET_SIZE, 0);

#[inline(always)]
pub fn route(name: &Name) -> Option<FibEntry> {
    flat::lookup(&Memory(FIB.get(0)?), name)
}

#[inline(always)]
pub fn is_permitted(link: &LinkEntry, name: &Name) -> bool {
    PERMITS.get_ptr(Permit { name: *name, link: link.id, reserved: 0 }).is_some()
}

#[inline(always)]
pub fn next_hop(bit: u32) -> u32 {
    NEXT_HOP.get(bit).copied().unwrap_or(0)
}

struct Memory(&'static Table);

impl flat::Memory for Memory {
    type Bucket = Bucket;

    #[inline(always)]
    fn bucket(&self, index: u32) -> Option<Bucket> {
        self.0.get_ptr(index).map(|bucket| Bucket(bucket.cast()))
    }
}

/// The first word of an element of the table.
#[derive(Clone, Copy)]
struct Bucket(*const u64);

impl flat::Words for Bucket {
    #[inline(always)]
    fn load(self, index: usize) -> u64 {
        // SAFETY: within the element, whose memory stays while the program runs; aligned; the kernel's JIT makes one load of it.
        unsafe { self.0.add(index).read_volatile() }
    }

    /// A load whose address depends on what another load returned happens after that one, on every machine the kernel runs on, and
    /// costs no barrier.
    #[cfg(target_arch = "bpf")]
    #[inline(always)]
    fn after(self, loaded: u64) -> Self {
        let mut words = self.0;
        // SAFETY: adds zero, in a way that neither the compiler nor the JIT sees through; touches two registers.
        unsafe {
            core::arch::asm!(
                "{loaded} &= 0",
                "{words} += {loaded}",
                loaded = inout(reg) loaded => _,
                words = inout(reg) words,
            );
        }
        Self(words)
    }

    /// On the host.
    #[cfg(not(target_arch = "bpf"))]
    fn after(self, _loaded: u64) -> Self {
        core::sync::atomic::fence(core::sync::atomic::Ordering::Acquire);
        self
    }
}
