//! Programs for `cargo xtask bench forward` and the kernel tests, loaded in addition to the switch:
//! generators, a sink, the minimal switch [`bare`], and [`bench_lookups`].
//!
//! Generators run under `BPF_PROG_TEST_RUN` with live frames: the kernel passes them frames, and
//! they redirect the frames to an interface. The sink is attached to the interface where the frames
//! should arrive. A generator acts as an endpoint: it counts and tags each frame. It does so for
//! every forwarder under test, also for those that ignore the tag. The cost of the generator is
//! therefore the same in all comparisons.
#![cfg_attr(target_arch = "bpf", no_std, no_main, feature(asm_experimental_arch))]

mod bench_lookups;
mod bench_names;
mod fib;
mod opaque;

use aya_ebpf::bindings::xdp_action::{XDP_ABORTED, XDP_DROP, XDP_PASS};
use aya_ebpf::helpers::bpf_ktime_get_ns;
use aya_ebpf::macros::{map, xdp};
use aya_ebpf::maps::{Array, DevMap};
use aya_ebpf::programs::XdpContext;
use gdp_wire::{Header, LinkEntry, Name, hop};

/// Length of the part of a frame that forwarding rewrites: the first 104 bytes. They cover at most
/// Ethernet with a VLAN tag, IPv6, UDP, and a GDP header up to the destination name.
const TEMPLATE_WORDS: usize = 13;

/// Upper bound and mask of the offset of the GDP header in a template.
const MAX_HEADER_AT: usize = 127;

/// Number of unknown names that [`flood`] cycles through.
const UNKNOWN_NAMES: u64 = 1 << 20;

/// Describes the frames to generate. Written by user space while no generator runs.
#[repr(C)]
#[derive(Clone, Copy)]
struct Pattern {
    template: [u64; TEMPLATE_WORDS],
    /// All ones, or 0 for frames to a switch that expects 0 as every tag.
    tag_mask: u64,
    /// Nanoseconds between the frames of [`flood`] to the known name.
    known_interval: u64,
    /// Nanoseconds between the frames to unknown names; 0 for none.
    unknown_interval: u64,
    /// Offset of the GDP header in the frame.
    header_at: u64,
    /// Number of copies that arrive for each frame that [`generate`] sends.
    copies: u64,
    /// Maximum number of frames of [`generate`] in flight, counted in copies that are to arrive.
    window: u64,
    /// Not 0: the generator drops its frames and counts them as arrived.
    discard: u64,
}

#[map]
static PATTERN: Array<Pattern> = Array::with_max_entries(1, 0);

/// Entry 0: the link that frames leave on. Written by user space while no generator runs.
#[map]
static LINK: Array<LinkEntry> = Array::with_max_entries(1, 0);

/// Entry 0: the egress interface. Written by user space before any program runs.
#[map]
static OUT: DevMap = DevMap::with_max_entries(1, 0);

/// Entry 0: number of copies to expect of the frames sent to the known name. Written by the
/// generator, which runs on one CPU, and by user space while no generator runs.
#[map]
static SENT: Array<u64> = Array::with_max_entries(1, 0);

/// Entry 0: frames sent on the link, to any name. Written by the generators only, and never reset.
#[map]
static LINK_COUNT: Array<u64> = Array::with_max_entries(1, 0);

/// The times of the next frames of [`flood`]: to the known name, and to an unknown name. Written by
/// [`flood`] only.
#[map]
static DUE: Array<[u64; 2]> = Array::with_max_entries(1, 0);

/// Entry 0: frames that arrived. Written by the sink, and by a generator that drops its frames, on
/// the CPU of the generator. User space pins the generator to one CPU, and veths process its frames
/// on the same CPU.
#[map]
static ARRIVED: Array<u64> = Array::with_max_entries(1, 0);

/// Sends frames to the known name at the rate of their arrival.
#[xdp]
pub fn generate(context: XdpContext) -> u32 {
    let (Some(pattern), Some(sent), Some(arrived)) = (PATTERN.get(0), SENT.get_ptr_mut(0), ARRIVED.get_ptr(0)) else {
        return XDP_ABORTED;
    };
    // SAFETY: elements of the maps; the word that another CPU may write is read once.
    let (count, done) = unsafe { (*sent, arrived.read_volatile()) };
    if count.wrapping_sub(done) + pattern.copies > pattern.window {
        return XDP_DROP;
    }
    // SAFETY: an element of the map that only this program writes.
    unsafe { *sent = count + pattern.copies };
    send(&context, None)
}

/// Sends frames to the known name at a fixed rate, and to unknown names at another.
#[xdp]
pub fn flood(context: XdpContext) -> u32 {
    let (Some(pattern), Some(due), Some(sent)) = (PATTERN.get(0), DUE.get_ptr_mut(0), SENT.get_ptr_mut(0)) else {
        return XDP_ABORTED;
    };
    // SAFETY: elements of the maps that only this program writes; a helper without arguments.
    let (due, sent, now) = unsafe { (&mut *due, &mut *sent, bpf_ktime_get_ns()) };
    if is_due(&mut due[0], now, pattern.known_interval) {
        *sent += 1;
        return send(&context, None);
    }
    if pattern.unknown_interval != 0 && is_due(&mut due[1], now, pattern.unknown_interval) {
        let Some(count) = LINK_COUNT.get(0) else { return XDP_ABORTED };
        return send(&context, Some(unknown_name(count % UNKNOWN_NAMES)));
    }
    XDP_DROP
}

/// Redirects every packet to the egress interface without looking at it: the minimal switch.
#[xdp]
pub fn bare(_context: XdpContext) -> u32 {
    OUT.redirect(0, XDP_DROP.into()).unwrap_or(XDP_ABORTED)
}

/// Counts frames and drops them. Passes the short frames of the hosts, such as ARP.
#[xdp]
pub fn sink(context: XdpContext) -> u32 {
    const SMALLEST: usize = 110;
    if context.data_end() - context.data() < SMALLEST {
        return XDP_PASS;
    }
    arrive()
}

/// Counts a frame and drops it.
#[inline(always)]
fn arrive() -> u32 {
    if let Some(arrived) = ARRIVED.get_ptr_mut(0) {
        // SAFETY: an element of the map that only the programs on this CPU write.
        unsafe { *arrived += 1 };
    }
    XDP_DROP
}

/// Writes, counts, tags and sends a frame, to the name of the template or to `destination`.
#[inline(always)]
fn send(context: &XdpContext, destination: Option<Name>) -> u32 {
    let (start, end) = (context.data(), context.data_end());
    let (Some(pattern), Some(link), Some(count)) = (PATTERN.get(0), LINK.get(0), LINK_COUNT.get_ptr_mut(0)) else {
        return XDP_ABORTED;
    };
    if start + TEMPLATE_WORDS * 8 > end {
        return XDP_ABORTED;
    }
    // The kernel reuses the pages of received frames, including all bytes that were rewritten on
    // the path.
    let mut i = 0;
    while i < TEMPLATE_WORDS {
        // SAFETY: within the bounds checked above.
        unsafe { *(start as *mut u64).add(i) = pattern.template[i] };
        i += 1;
    }
    let at = start + (pattern.header_at as usize & MAX_HEADER_AT);
    if at + Header::LEN > end {
        return XDP_ABORTED;
    }
    // SAFETY: within the bounds just checked; for the alignment see `packet`. The count is an
    // element of a map that only one program writes at a time.
    let (header, count) = unsafe { (&mut *(at as *mut Header), &mut *count) };
    if let Some(destination) = destination {
        header.destination = destination;
    }
    *count += 1;
    hop::stamp(header, link, *count);
    header.set_tag(header.tag() & pattern.tag_mask);
    if pattern.discard != 0 {
        return arrive();
    }
    OUT.redirect(0, XDP_DROP.into()).unwrap_or(XDP_ABORTED)
}

/// Returns whether the time `due` has passed, and if so advances `due` by `interval`. A backlog of
/// less than 20 milliseconds is caught up; a longer one is skipped.
#[inline(always)]
fn is_due(due: &mut u64, now: u64, interval: u64) -> bool {
    const MISSED: u64 = 20_000_000;
    if now < *due {
        return false;
    }
    let since = if now - *due > MISSED { now } else { *due };
    *due = since + interval;
    true
}

/// Returns a distinct name for each number, as evenly distributed as the hashes that real names
/// are.
#[inline(always)]
fn unknown_name(number: u64) -> Name {
    // The finalizer of SplitMix64.
    let mut word = number.wrapping_add(0x9e37_79b9_7f4a_7c15);
    word = (word ^ word >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    word = (word ^ word >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    word ^= word >> 31;
    // SAFETY: a name is four words, all values of which are valid.
    unsafe { core::mem::transmute([word, !word, word.rotate_left(17), word.rotate_left(41)]) }
}

#[cfg(all(target_arch = "bpf", not(test)))]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}

/// On the host, the crate compiles only for lints and editors.
#[cfg(not(target_arch = "bpf"))]
fn main() {}
