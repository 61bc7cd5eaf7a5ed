//! The interfaces that take redirected frames, by interface index. User space writes an interface
//! before a link with that port exists. The entry of a removed interface is empty; a redirect to it
//! fails and is counted. Where copies leave, an element includes the egress program; see `main`.

use aya_ebpf::bindings::xdp_action::XDP_DROP;
use aya_ebpf::macros::map;
use aya_ebpf::maps::DevMapHash;
use gdp_wire::table::MAX_PORTS;

#[map]
static PORTS: DevMapHash = DevMapHash::with_max_entries(MAX_PORTS, 0);

/// Sends the packet to `port` when the program returns. Returns `false` if the interface does not
/// exist.
#[inline(always)]
pub fn redirect(port: u32) -> bool {
    let redirected = || PORTS.redirect(port, XDP_DROP.into()).is_ok();
    // The element is missing for some nanoseconds while user space replaces it.
    redirected() || redirected()
}

/// Returns whether the interface exists.
#[inline(always)]
pub fn is_there(port: u32) -> bool {
    PORTS.get_ifindex(port).is_some()
}
