//! What a lookup costs: programs that ask for one random name at a time, in the FIB of the switch
//! and in a hash of the kernel, for `bench forward` under `BPF_PROG_TEST_RUN`. And what a lookup
//! finds while user space changes the FIB, for the kernel tests.

use aya_ebpf::bindings::xdp_action::{XDP_ABORTED, XDP_DROP};
use aya_ebpf::macros::{map, xdp};
use aya_ebpf::maps::{Array, HashMap};
use aya_ebpf::programs::XdpContext;
use gdp_wire::{FibEntry, Name, flat};

use crate::{bench_names, fib};

/// Of a packet, from its beginning. The programs write all but `mask` and `stored`.
#[repr(C)]
struct Question {
    ethernet: [u64; 2],
    /// Of the random numbers.
    state: u64,
    /// One less than the number of names to choose from, which is a power of two.
    mask: u64,
    /// Names from 0 on that must be found.
    stored: u64,
    name: [u64; 4],
}

/// The plain hash of the kernel, preallocated. User space sets the real capacity.
#[map]
static HASH: HashMap<Name, FibEntry> = HashMap::with_max_entries(1, 0);

/// Lookups that found a route of the name, that found something else, and that missed one of the
/// names that must be found. Written by these programs, of which one runs at a time.
#[map]
static FOUND: Array<[u64; 3]> = Array::with_max_entries(1, 0);

/// Only what the others do besides.
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
    // SAFETY: elements are preallocated, so the memory stays an entry; nobody removes any while
    // this runs.
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
    // SAFETY: a name is four words, whichever.
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
