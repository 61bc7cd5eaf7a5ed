//! The interface that endpoints on the switch's own host send frames to. Behind its program there
//! is no host: its other end is an interface of the same one, which takes the address that frames
//! are sent to here for another machine's. So what is the daemon's is sent back as a datagram to
//! this host, from the address that it came to, and everything else ends here.

use aya_ebpf::bindings::xdp_action::{XDP_DROP, XDP_REDIRECT};
use aya_ebpf::programs::XdpContext;
use gdp_wire::Counter;

use crate::carrier::udp4;
use crate::packet::Packet;
use crate::{config, ports};

/// Whether the packet came from an endpoint of this host.
#[inline(always)]
pub fn is_ingress(context: &XdpContext) -> bool {
    context.ingress_ifindex() as u32 == config::get().host_pair
}

/// The action for a packet that the switch does not take, and has left untouched. It goes back by a
/// redirect: what a veth is to send by XDP_TX it only hands over if there is a program at the other
/// end.
#[inline(always)]
pub fn leave(context: &XdpContext, counter: Counter) -> u32 {
    let goes_back = counter as u32 == Counter::Slow as u32 && udp4::turn_back(&Packet::of(context));
    if goes_back && ports::redirect(config::get().host_pair) { XDP_REDIRECT } else { XDP_DROP }
}
