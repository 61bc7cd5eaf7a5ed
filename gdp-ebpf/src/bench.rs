//! What `cargo xtask bench forward` and kernel tests run around the switch: generator and sink, and [`bench_lookups`].
//!
//! The generator runs under `BPF_PROG_TEST_RUN` with live frames: the kernel hands it frames, it sends them by an interface, as
//! long as not too many are under way. The sink sits on the interface where they should arrive.
//!
//! Toward a switch the generator is an endpoint, which counts and tags each frame; that is work of its own for each frame, beside
//! what is measured.
#![cfg_attr(target_arch = "bpf", no_std, no_main, feature(asm_experimental_arch))]

mod bench_lookups;
mod bench_names;
mod fib;

use aya_ebpf::bindings::xdp_action::{XDP_ABORTED, XDP_DROP, XDP_PASS};
use aya_ebpf::macros::{map, xdp};
use aya_ebpf::maps::{Array, DevMap};
use aya_ebpf::programs::XdpContext;
use gdp_wire::{Header, LinkEntry, forward};

/// What forwarding changes lies in the first 48 bytes: Ethernet and all of a GDP header before the destination name, or
/// Ethernet, IPv4 and UDP.
const CHANGED_WORDS: usize = 6;

const ETHERNET_LEN: usize = 14;

/// Frames under way at most. Less than a veth's ring of 256 would hold back the planes that work in batches; more than the
/// receive buffer of a packet socket takes would lose frames.
const WINDOW: u64 = 1024;

/// The first bytes of every frame. Written by user space while the generator does not run.
#[map]
static TEMPLATE: Array<[u64; CHANGED_WORDS]> = Array::with_max_entries(1, 0);

/// Entry 0: where frames leave. Written by user space before the generator runs.
#[map]
static OUT: DevMap = DevMap::with_max_entries(1, 0);

/// Entry 0: frames sent. Written by the generator, which runs on one CPU; by user space while it does not run.
#[map]
static SENT: Array<u64> = Array::with_max_entries(1, 0);

/// Entry 0: the link that frames leave by; one with id 0 if they are no GDP frames. Written by user space while the generator
/// does not run.
#[map]
static LINK: Array<LinkEntry> = Array::with_max_entries(1, 0);

/// Entry 0: frames sent on the link. Written by the generator only, and never begun again.
#[map]
static LINK_COUNT: Array<u64> = Array::with_max_entries(1, 0);

/// Entry 0: frames that arrived. Written by the sink: its interface has one queue, so it runs on one CPU at a time.
#[map]
static ARRIVED: Array<u64> = Array::with_max_entries(1, 0);

#[xdp]
pub fn generate(context: XdpContext) -> u32 {
    let (start, end) = (context.data(), context.data_end());
    let (Some(template), Some(sent), Some(arrived)) = (TEMPLATE.get(0), SENT.get_ptr_mut(0), ARRIVED.get_ptr(0)) else {
        return XDP_ABORTED;
    };
    let (Some(link), Some(link_count)) = (LINK.get(0), LINK_COUNT.get_ptr_mut(0)) else { return XDP_ABORTED };
    // SAFETY: elements of the maps; what another CPU writes meanwhile is read once.
    let (count, done) = unsafe { (*sent, arrived.read_volatile()) };
    if count.wrapping_sub(done) >= WINDOW || start + CHANGED_WORDS * 8 > end {
        return XDP_DROP;
    }
    // The kernel reuses the pages of frames that were received, with all that was rewritten on the way.
    let mut i = 0;
    while i < CHANGED_WORDS {
        // SAFETY: within the bounds checked above.
        unsafe { *(start as *mut u64).add(i) = template[i] };
        i += 1;
    }
    let at = start + ETHERNET_LEN;
    if link.id != 0 && at + Header::LEN <= end {
        // SAFETY: within the bounds just checked; for the alignment see `packet`.
        let header = unsafe { &mut *(at as *mut Header) };
        // SAFETY: an element of the map that only this program writes.
        let link_count = unsafe { &mut *link_count };
        *link_count += 1;
        forward::stamp(header, link, *link_count);
    }
    // SAFETY: an element of the map that only this program writes.
    unsafe { *sent = count + 1 };
    OUT.redirect(0, 0).unwrap_or(XDP_ABORTED)
}

/// Counts frames and drops them; lets what hosts say to each other (ARP, and other short ones) pass.
#[xdp]
pub fn sink(context: XdpContext) -> u32 {
    const SMALLEST: usize = 110;
    if context.data_end() - context.data() < SMALLEST {
        return XDP_PASS;
    }
    if let Some(arrived) = ARRIVED.get_ptr_mut(0) {
        // SAFETY: an element of the map that only this program writes.
        unsafe { *arrived += 1 };
    }
    XDP_DROP
}

#[cfg(all(target_arch = "bpf", not(test)))]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}

/// On the host the crate only compiles, for lints and editors.
#[cfg(not(target_arch = "bpf"))]
fn main() {}
