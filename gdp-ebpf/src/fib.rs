//! Where names lead. `FIB` holds one flat table (`gdp_wire::flat`, which says what a reader may
//! meet), in an array that user space maps and writes while programs read. To grow, user space
//! fills another array and puts it in the place of the first: a program runs to its end on the one
//! that it began with.

use aya_ebpf::bindings::{BPF_F_INNER_MAP, BPF_F_MMAPABLE};
use aya_ebpf::btf_maps::{Array, ArrayOfMaps};
use aya_ebpf::macros::btf_map;
use gdp_wire::flat::{self, BUCKET};
use gdp_wire::{FibEntry, Name};

/// Tables differ in size, which only `BPF_F_INNER_MAP` allows.
type Table = Array<[u64; BUCKET], 1, { (BPF_F_MMAPABLE | BPF_F_INNER_MAP) as usize }>;

#[btf_map]
static FIB: ArrayOfMaps<Table, 1> = ArrayOfMaps::new();

#[inline(always)]
pub fn route(name: &Name) -> Option<FibEntry> {
    flat::lookup(&Memory(FIB.get(0)?), name)
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
        // SAFETY: within the element, whose memory stays while the program runs; aligned; the
        // kernel's JIT makes one load of it.
        unsafe { self.0.add(index).read_volatile() }
    }

    /// A load whose address depends on what another load returned happens after that one, on every
    /// machine the kernel runs on, and costs no barrier.
    #[cfg(target_arch = "bpf")]
    #[inline(always)]
    fn after(self, loaded: u64) -> Self {
        let mut words = self.0;
        // SAFETY: adds zero, in a way that neither the compiler nor the JIT sees through; touches
        // two registers.
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
