//! The XDP programs of a switch. Everything that decides is in `gdp_wire::forward`; here is only what the kernel needs
//! done around it: find the header in the packet, look up in BPF maps, carry the verdict out, count.
//!
//! Loaded by `gdp_ctl::plane::kernel`. The modules are the maps, each with the rule of who may write it when; [`packet`] and
//! [`carrier`], what is around a frame; and [`next_hop`]. Only this file turns outcomes into XDP actions and counters.
//!
//! Two programs do the same: [`gdp_switch`] takes packets that span several buffers (MTU above about 3500), which
//! kernels before 5.18 cannot; for those there is [`gdp_switch_linear`].
#![cfg_attr(target_arch = "bpf", no_std, no_main, feature(asm_experimental_arch))]

mod carrier;
mod config;
mod counters;
mod fib;
mod host_pair;
mod links;
mod local;
mod losses;
mod next_hop;
mod next_hops;
mod packet;
mod permits;
mod ports;
mod tables;
mod tally;
mod windows;

use aya_ebpf::bindings::xdp_action::{XDP_DROP, XDP_PASS, XDP_REDIRECT};
use aya_ebpf::macros::xdp;
use aya_ebpf::programs::XdpContext;
use gdp_wire::forward::{self, Kind, Verdict};
use gdp_wire::table::PORT_ROUTED;
use gdp_wire::{Counter, Header};

use crate::carrier::Carried;
use crate::carrier::ethernet::Ethernet;
use crate::next_hop::NextHop;
use crate::packet::Packet;
use crate::tables::Maps;

/// The switch, on kernels from 5.18 on.
#[xdp(frags)]
pub fn gdp_switch(context: XdpContext) -> u32 {
    let length = packet::length(&context);
    act(&context, handle(&context, length))
}

/// The switch, on older kernels.
#[xdp]
pub fn gdp_switch_linear(context: XdpContext) -> u32 {
    let length = context.data_end().saturating_sub(context.data());
    act(&context, handle(&context, length))
}

/// For the interface of an endpoint on a veth: a veth takes redirected frames only if its other end runs a program
/// (or has GRO on).
#[xdp(frags)]
pub fn gdp_pass(_context: XdpContext) -> u32 {
    XDP_PASS
}

/// What became of a packet.
enum Outcome {
    /// It is on its way to another interface.
    Redirected(Counter),
    /// The host takes it, untouched but for what [`host_pair`] does.
    Passed(Counter),
    Dropped(Counter),
}

impl Outcome {
    #[inline(always)]
    fn counter(&self) -> Counter {
        match self {
            Outcome::Redirected(counter) | Outcome::Passed(counter) | Outcome::Dropped(counter) => *counter,
        }
    }
}

#[inline(always)]
fn act(context: &XdpContext, outcome: Outcome) -> u32 {
    counters::count(outcome.counter());
    match outcome {
        Outcome::Redirected(_) => XDP_REDIRECT,
        Outcome::Passed(counter) if host_pair::is_ingress(context) => host_pair::leave(context, counter),
        Outcome::Passed(_) => XDP_PASS,
        Outcome::Dropped(_) => XDP_DROP,
    }
}

#[inline(always)]
fn handle(context: &XdpContext, length: usize) -> Outcome {
    let mut packet = Packet::of(context);
    if packet.get::<Ethernet>(0).is_none() {
        return Outcome::Dropped(Counter::Truncated);
    }
    let Some(carried) = carrier::find(context, &packet, length, config::get().ethertype) else {
        return Outcome::Passed(Counter::Foreign);
    };
    // Behind an empty datagram there may be padding.
    let Some(first_byte) = packet.get::<u8>(carried.at).filter(|_| carried.available > 0) else {
        return Outcome::Dropped(Counter::Truncated);
    };
    // SAFETY: `get` checked the bounds.
    let first_byte = unsafe { *first_byte };
    if carrier::is_quic(&carried, first_byte) {
        return Outcome::Passed(Counter::Control);
    }
    match forward::classify(first_byte) {
        Kind::Headed => match packet.header(carried.at) {
            Some(header) => forward_frame(context, header, carried, length),
            None => Outcome::Dropped(Counter::Truncated),
        },
        Kind::Control => Outcome::Passed(Counter::Control),
        Kind::Unknown => Outcome::Dropped(Counter::Unknown),
    }
}

#[inline(always)]
fn forward_frame(context: &XdpContext, header: &mut Header, carried: Carried, length: usize) -> Outcome {
    let (ingress, tag) = (header.link_id(), header.tag());
    let outcome = forward_headed(context, header, tag, carried, length);
    tally::count_arrival(ingress, outcome.counter());
    outcome
}

#[inline(always)]
fn forward_headed(context: &XdpContext, header: &mut Header, tag: u64, carried: Carried, length: usize) -> Outcome {
    let tables = Maps { context, length: header.frame_len(), next_hop: NextHop::new() };
    let (link, counter) = match forward::decide(header, carried.available, &tables) {
        Verdict::Send(link, counter) => {
            tally::sample(tag, header);
            (link, counter)
        }
        Verdict::Answer(link, counter) => (link, counter),
        // The kernel leaves these to the daemon, so they do not come up.
        Verdict::Notice(_) | Verdict::Copies(_) | Verdict::Slow => return Outcome::Passed(Counter::Slow),
        Verdict::Drop(counter) => return Outcome::Dropped(counter),
    };
    // An answer has no payload, so this is its length as well.
    let (frame, class) = (header.frame_len(), carrier::class_of(header));
    let behind = length - carried.at - frame;
    if !carrier::exchange(context, carried.at, frame, behind, class, link, &tables.next_hop) {
        return Outcome::Dropped(Counter::RedirectFailed);
    }
    let port = if link.port == PORT_ROUTED { tables.next_hop.port() } else { link.port };
    if ports::redirect(port) { Outcome::Redirected(counter) } else { Outcome::Dropped(Counter::RedirectFailed) }
}

#[cfg(all(target_arch = "bpf", not(test)))]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}

/// On the host the crate only compiles, for lints and editors.
#[cfg(not(target_arch = "bpf"))]
fn main() {}
