//! Generator and sink of `cargo xtask bench forward`. The generator runs under `BPF_PROG_TEST_RUN` with live frames: the
//! kernel hands it frames, it sends them by an interface. The sink sits on the interface where they should arrive.
#![cfg_attr(target_arch = "bpf", no_std, no_main)]

use aya_ebpf::bindings::xdp_action::{XDP_ABORTED, XDP_DROP, XDP_PASS};
use aya_ebpf::macros::{map, xdp};
use aya_ebpf::maps::{Array, DevMap, PerCpuArray};
use aya_ebpf::programs::XdpContext;

/// What forwarding changes lies in the first 48 bytes: Ethernet and all of a GDP header before the destination name, or
/// Ethernet, IPv4 and UDP.
const CHANGED_WORDS: usize = 6;

/// The first bytes of every frame. Written once, before the generator runs.
#[map]
static TEMPLATE: Array<[u64; CHANGED_WORDS]> = Array::with_max_entries(1, 0);

/// Entry 0: where frames leave. Written once, before the generator runs.
#[map]
static OUT: DevMap = DevMap::with_max_entries(1, 0);

/// Entry 0: frames that arrived at the sink. Each CPU writes its own.
#[map]
static ARRIVED: PerCpuArray<u64> = PerCpuArray::with_max_entries(1, 0);

#[xdp]
pub fn generate(context: XdpContext) -> u32 {
    let (start, end) = (context.data(), context.data_end());
    let (Some(template), true) = (TEMPLATE.get(0), start + CHANGED_WORDS * 8 <= end) else { return XDP_ABORTED };
    // The kernel reuses the pages of frames that were received, with all that was rewritten on the way.
    let mut i = 0;
    while i < CHANGED_WORDS {
        // SAFETY: within the bounds checked above.
        unsafe { *(start as *mut u64).add(i) = template[i] };
        i += 1;
    }
    OUT.redirect(0, 0).unwrap_or(XDP_ABORTED)
}

/// Counts frames of at least `TEMPLATE`'s size and drops them; lets what hosts say to each other pass.
#[xdp]
pub fn sink(context: XdpContext) -> u32 {
    const SMALLEST: usize = 110;
    if context.data_end() - context.data() < SMALLEST {
        return XDP_PASS;
    }
    if let Some(arrived) = ARRIVED.get_ptr_mut(0) {
        // SAFETY: this CPU's own slot.
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
