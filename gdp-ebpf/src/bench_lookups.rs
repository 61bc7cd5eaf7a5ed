//! Lookup benchmarks: programs that look up one random name per run, in the FIB of the switch or in
//! a hash map of the kernel. `bench forward` runs them under `BPF_PROG_TEST_RUN`. The kernel tests
//! use them to check the results of lookups while user space changes the FIB.

use aya_ebpf::bindings::xdp_action::{XDP_ABORTED, XDP_DROP};
use aya_ebpf::macros::{map, xdp};
use aya_ebpf::maps::{Array, HashMap};
use aya_ebpf::programs::XdpContext;
use gdp_wire::{FibEntry, Name, flat};

use crate::{bench_names, fib};

/// The layout of a packet, from its first byte. The programs write all fields except `mask` and
/// `stored`.
#[repr(C)]
struct Question {
    ethernet: [u64; 2],
    /// State of the random number generator.
    state: u64,
    /// One less than the number of names to choose from, which is a power of two.
    mask: u64,
    /// Number of names, from name 0 on, that every lookup must find.
    stored: u64,
    name: [u64; 4],
}

/// A plain, preallocated hash map of the kernel. User space sets the real capacity.
#[map]
static HASH: HashMap<Name, FibEntry> = HashMap::with_max_entries(1, 0);

/// Counts of lookups: those that found a route of the name, those that found something else, and
/// those that missed a name they must find. Written by these programs, one of which runs at a time.
#[map]
static FOUND: Array<[u64; 3]> = Array::with_max_entries(1, 0);

/// Measures the overhead that all three programs share.
#[xdp]
pub fn lookup_none(context: XdpContext) -> u32 {
    ask(&context, |name, number| Some(flat::from_words(bench_names::route(number, name.words()[0]))))
}

#[xdp]
pub fn lookup_flat(context: XdpContext) -> u32 {
    ask(&context, |name, _| fib::route(name))
}

#[xdp]
pub fn lookup_hash(context: XdpContext) -> u32 {
    // SAFETY: elements are preallocated, so the memory always contains an entry. No element is
    // removed while this program runs.
    ask(&context, |name, _| HASH.get_ptr(name).map(|entry| unsafe { *entry }))
}

#[inline(always)]
fn ask(context: &XdpContext, look_up: impl Fn(&Name, u64) -> Option<FibEntry>) -> u32 {
    let (start, end) = (context.data(), context.data_end());
    if start + size_of::<Question>() > end {
        return XDP_ABORTED;
    }
    // SAFETY: the bounds are checked; packets of a test run begin at a multiple of 8.
    let question = unsafe { &mut *(start as *mut Question) };
    question.state = question.state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
    let number = question.state >> 33 & question.mask;
    question.name = bench_names::name(number);
    // SAFETY: a name is four words, and all values are valid.
    let name = unsafe { &*(&raw const question.name).cast::<Name>() };
    let found = match look_up(name, number) {
        Some(entry) if bench_names::is_route(number, flat::to_words(entry)) => 0,
        Some(_) => 1,
        None if number < question.stored => 2,
        None => return XDP_DROP,
    };
    let Some(counts) = FOUND.get_ptr_mut(0) else { return XDP_ABORTED };
    // SAFETY: an element of the map that only this program writes.
    unsafe { (*counts)[found] += 1 };
    XDP_DROP
}
