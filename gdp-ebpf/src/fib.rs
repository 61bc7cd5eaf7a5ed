//! The FIB. The map `FIB` contains one flat table, an array that user space maps and writes while
//! programs read. `gdp_wire::flat` specifies the states that a reader may see. To grow the table,
//! user space fills a new array and replaces the old one. A program that has started on the old
//! array finishes on it.

use aya_ebpf::bindings::{BPF_F_INNER_MAP, BPF_F_MMAPABLE};
use aya_ebpf::btf_maps::{Array, ArrayOfMaps};
use aya_ebpf::macros::btf_map;
use gdp_wire::flat::{self, BUCKET};
use gdp_wire::{FibEntry, Name};

use crate::opaque::zero;

/// Tables of different sizes require `BPF_F_INNER_MAP`.
type Table = Array<[u64; BUCKET], 1, { (BPF_F_MMAPABLE | BPF_F_INNER_MAP) as usize }>;

#[btf_map]
static FIB: ArrayOfMaps<Table, 1> = ArrayOfMaps::new();

#[inline(always)]
pub fn route(name: &Name) -> Option<FibEntry> {
    let mut entry = flat::from_words([zero(); 3]);
    (gdp_find_route(name, &mut entry) != 0).then_some(entry)
}

/// Writes the route of `name` to `entry`. Returns 0 if there is none.
///
/// This is a global function of the object, so the verifier checks it once, for any arguments. The
/// many steps of a lookup would otherwise be checked again in every state that reaches them.
#[unsafe(no_mangle)]
#[inline(never)]
pub extern "C" fn gdp_find_route(name: *const Name, entry: *mut FibEntry) -> u32 {
    // SAFETY: the verifier ensures that each is null or has the size of its type, and the only
    // caller that nothing else refers to `entry`.
    let (Some(name), Some(entry)) = (unsafe { name.as_ref() }, unsafe { entry.as_mut() }) else { return 0 };
    let Some(found) = FIB.get(0).and_then(|table| flat::lookup(&Memory(table), name)) else { return 0 };
    *entry = found;
    1
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
        // SAFETY: within the element, whose memory remains valid while the program runs. Aligned.
        // The kernel's JIT emits one load.
        unsafe { self.0.add(index).read_volatile() }
    }

    /// Orders loads by an address dependency, without a barrier. On every architecture of the
    /// kernel, a load whose address depends on another load happens after that load.
    #[cfg(target_arch = "bpf")]
    #[inline(always)]
    fn after(self, loaded: u64) -> Self {
        let mut words = self.0;
        // SAFETY: adds zero in a form that neither the compiler nor the JIT can optimise away.
        // Changes two registers only.
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

    /// The host version, with an acquire fence.
    #[cfg(not(target_arch = "bpf"))]
    fn after(self, _loaded: u64) -> Self {
        core::sync::atomic::fence(core::sync::atomic::Ordering::Acquire);
        self
    }
}
