//! Counts the frames that are lost after the switch has redirected them. The verdict only queues a
//! frame. The kernel passes the frames to the egress interface later, in batches, and does not
//! report rejected frames to the program. Two tracepoints report them.
//!
//! The tracepoints cover the whole machine. A loss therefore counts only between two watched
//! interfaces: keys of `REDIRECT_LOSSES` in the network namespace of `NET_DEVICES`. Only user space
//! writes keys; only these programs write values, on the CPU that owns them. The tracepoints fire
//! on the CPU of the switch program, and a program does not interrupt itself.

use core::ptr;

use aya_ebpf::bindings::bpf_map_type::{BPF_MAP_TYPE_DEVMAP, BPF_MAP_TYPE_DEVMAP_HASH};
use aya_ebpf::helpers::bpf_probe_read_kernel;
use aya_ebpf::macros::{map, raw_tracepoint};
use aya_ebpf::maps::PerCpuHashMap;
use aya_ebpf::programs::RawTracePointContext;
use gdp_wire::Counter;
use gdp_wire::losses::NetDevices;

use crate::{copies, counters};

/// Frames lost on the path to an interface, by interface index.
#[map]
static REDIRECT_LOSSES: PerCpuHashMap<u32, u64> = PerCpuHashMap::with_max_entries(256, 0);

/// Written by user space before the object is loaded.
#[unsafe(no_mangle)]
static NET_DEVICES: NetDevices = NetDevices { namespace: 0, ifindex: 0, net: 0, inum: 0 };

/// `xdp_devmap_xmit(from_dev, to_dev, sent, drops, err)`: the kernel passed a batch to an
/// interface. `drops` includes the packets that the egress program dropped. Those are superfluous
/// copies and not losses.
#[raw_tracepoint(tracepoint = "xdp_devmap_xmit")]
pub fn gdp_devmap_xmit(context: RawTracePointContext) -> i32 {
    let drops: i32 = context.arg(3);
    if drops > 0 {
        lost(context.arg(0), context.arg(1), |to| (drops as u64).saturating_sub(copies::take_superfluous(to)));
    }
    0
}

/// `xdp_redirect_err(dev, prog, target, err, map_type, map_id, index)`: the kernel refused a frame
/// before adding it to a batch. No tracepoint reports an interface that a broadcast skips because
/// it is down or takes no redirected frames.
#[raw_tracepoint(tracepoint = "xdp_redirect_err")]
pub fn gdp_redirect_err(context: RawTracePointContext) -> i32 {
    let (target, map_type): (*const *const u8, u32) = (context.arg(2), context.arg(4));
    if map_type == BPF_MAP_TYPE_DEVMAP || map_type == BPF_MAP_TYPE_DEVMAP_HASH {
        // An entry of a device map begins with the interface; the kernel preserves this layout for
        // tracepoints. A broadcast has no target.
        let from = context.arg(0);
        lost(from, read(target).unwrap_or(from), |_| 1);
    }
    0
}

/// Counts `frames` of the index of the interface `to` as lost on the path from `from` to `to`.
#[inline(always)]
fn lost(from: *const u8, to: *const u8, frames: impl FnOnce(u32) -> u64) {
    if watched(from).is_some()
        && let Some((ifindex, losses)) = watched(to)
    {
        let frames = frames(ifindex);
        // SAFETY: the kernel returned a pointer to this CPU's value, which no other CPU writes.
        unsafe { *losses += frames };
        counters::add(Counter::RedirectLost, frames);
    }
}

/// Returns the index of a `struct net_device` and this CPU's count for it, if it is a watched
/// interface.
#[inline(always)]
fn watched(device: *const u8) -> Option<(u32, *mut u64)> {
    // SAFETY: a static. User space has replaced its value, so the compiler must not assume the
    // initial one.
    let at = unsafe { ptr::read_volatile(&raw const NET_DEVICES) };
    let net: *const u8 = read(device.wrapping_add(at.net as usize).cast())?;
    let inum: u32 = read(net.wrapping_add(at.inum as usize).cast())?;
    if at.namespace == 0 || inum != at.namespace {
        return None;
    }
    let ifindex: u32 = read(device.wrapping_add(at.ifindex as usize).cast())?;
    Some((ifindex, REDIRECT_LOSSES.get_ptr_mut(ifindex)?))
}

#[inline(always)]
fn read<T>(at: *const T) -> Option<T> {
    // SAFETY: the helper checks the address and fails if it is not mapped. Any bytes are valid
    // integers and pointers.
    unsafe { bpf_probe_read_kernel(at) }.ok()
}
