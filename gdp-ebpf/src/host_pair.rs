//! The veth that endpoints on the switch's own host send frames to. No host is behind the program
//! on this veth: its other end is an interface of the same host. The host treats the destination
//! address of these frames as that of another machine. The program therefore sends a datagram for
//! the daemon back to this host, with the original destination as its source. The program drops
//! everything else.

use aya_ebpf::bindings::xdp_action::{XDP_DROP, XDP_REDIRECT};
use aya_ebpf::programs::XdpContext;
use gdp_wire::Counter;

use crate::carrier::udp4;
use crate::packet::Packet;
use crate::{config, ports};

/// Returns whether the packet came from an endpoint on this host.
#[inline(always)]
pub fn is_ingress(context: &XdpContext) -> bool {
    context.ingress_ifindex() as u32 == config::get().host_pair
}

/// Returns the action for a packet that the switch does not take and has not changed. The packet
/// returns by a redirect: a veth delivers XDP_TX packets only if a program runs at the other end.
#[inline(always)]
pub fn leave(context: &XdpContext, counter: Counter) -> u32 {
    let goes_back = counter as u32 == Counter::Slow as u32 && udp4::turn_back(&Packet::of(context));
    if goes_back && ports::redirect(config::get().host_pair) { XDP_REDIRECT } else { XDP_DROP }
}
