//! The interfaces frames can leave by, by interface index: those that take redirected frames.
//! Written by user space before a link with that port exists. A port whose interface is gone is
//! empty, and a redirect to it fails and is counted. Where copies leave, an element has the program
//! of what leaves; see `main`.

use aya_ebpf::bindings::xdp_action::XDP_DROP;
use aya_ebpf::macros::map;
use aya_ebpf::maps::DevMapHash;
use gdp_wire::table::MAX_PORTS;

#[map]
static PORTS: DevMapHash = DevMapHash::with_max_entries(MAX_PORTS, 0);

/// Sends the packet to `port` when the program returns; `false` if there is no such interface.
#[inline(always)]
pub fn redirect(port: u32) -> bool {
    let redirected = || PORTS.redirect(port, XDP_DROP.into()).is_ok();
    // While user space replaces an element there is none for some nanoseconds.
    redirected() || redirected()
}

/// Whether there is such an interface.
#[inline(always)]
pub fn is_there(port: u32) -> bool {
    PORTS.get_ifindex(port).is_some()
}
