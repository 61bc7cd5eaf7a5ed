//! The XDP programs of a switch. Everything that decides is in `gdp_wire::forward`; here is only what the kernel needs
//! done around it: find the header in the packet, look up in BPF maps, carry the verdict out, count.
//!
//! Loaded by `gdp_ctl::plane::kernel`. The modules are the maps, each with the rule of who may write it when, and
//! [`packet`]. Only this file turns outcomes into XDP actions and counters.
//!
//! [`gdp_switch`] runs where a frame arrives, [`gdp_egress`] where the kernel has been told to send it. The second is there for the
//! copies of a frame; but the kernel runs one program over all frames that leave by an interface together, so every frame
//! comes by it.
//!
//! Of both there are two that do the same: those above take packets that span several buffers (MTU above about 3500), which
//! kernels before 5.18 cannot; for those there are [`gdp_switch_linear`] and [`gdp_egress_linear`].
#![cfg_attr(target_arch = "bpf", no_std, no_main, feature(asm_experimental_arch))]

mod config;
mod copies;
mod counters;
mod fib;
mod groups;
mod links;
mod packet;
mod ports;
mod tables;
mod windows;

use aya_ebpf::bindings::xdp_action::{XDP_DROP, XDP_PASS, XDP_REDIRECT};
use aya_ebpf::macros::xdp;
use aya_ebpf::programs::XdpContext;
use gdp_wire::forward::{self, Copy, Kind, Verdict};
use gdp_wire::{Counter, GroupPlace, Header, LinkEntry};

use crate::packet::Packet;
use crate::tables::Maps;

/// The switch, on kernels from 5.18 on.
#[xdp(frags)]
pub fn gdp_switch(context: XdpContext) -> u32 {
    let length = packet::length(&context);
    act(handle(&context, length))
}

/// The switch, on older kernels.
#[xdp]
pub fn gdp_switch_linear(context: XdpContext) -> u32 {
    let length = context.data_end().saturating_sub(context.data());
    act(handle(&context, length))
}

/// What leaves, on kernels from 5.18 on.
#[xdp(frags, map = "devmap")]
pub fn gdp_egress(context: XdpContext) -> u32 {
    act_at_egress(leave(&context))
}

/// What leaves, on older kernels.
#[xdp(map = "devmap")]
pub fn gdp_egress_linear(context: XdpContext) -> u32 {
    act_at_egress(leave(&context))
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
    /// The host takes it, untouched.
    Passed(Counter),
    Dropped(Counter),
}

#[inline(always)]
fn act(outcome: Outcome) -> u32 {
    let (counter, action) = match outcome {
        Outcome::Redirected(counter) => (counter, XDP_REDIRECT),
        Outcome::Passed(counter) => (counter, XDP_PASS),
        Outcome::Dropped(counter) => (counter, XDP_DROP),
    };
    counters::count(counter);
    action
}

/// What becomes of a packet that leaves.
enum Departure {
    /// It was made for its link before.
    Ready,
    /// It is a copy, now made for its link.
    Copied(Counter),
    /// It is a copy that nobody needs.
    Superfluous,
    /// It is such a copy, the last at its interface, and has become what no host takes: see [`copies`].
    Filler,
}

#[inline(always)]
fn act_at_egress(departure: Departure) -> u32 {
    match departure {
        Departure::Ready => XDP_PASS,
        Departure::Copied(counter) => {
            counters::count(counter);
            XDP_PASS
        }
        Departure::Superfluous => XDP_DROP,
        Departure::Filler => XDP_PASS,
    }
}

#[inline(always)]
fn handle(context: &XdpContext, length: usize) -> Outcome {
    let Some(packet) = Packet::parse(context, length) else { return Outcome::Dropped(Counter::Truncated) };
    if u32::from(packet.ethertype()) != config::get().ethertype {
        return Outcome::Passed(Counter::Foreign);
    }
    match packet.first_byte().map(forward::classify) {
        Some(Kind::Headed) => forward_frame(context, packet),
        Some(Kind::Control) => Outcome::Passed(Counter::Control),
        Some(Kind::Unknown) => Outcome::Dropped(Counter::Unknown),
        None => Outcome::Dropped(Counter::Truncated),
    }
}

#[inline(always)]
fn forward_frame(context: &XdpContext, mut packet: Packet) -> Outcome {
    let (length, in_one_buffer) = (packet.frame_length(), packet.is_in_one_buffer());
    let Some(header) = packet.header() else { return Outcome::Dropped(Counter::Truncated) };
    match forward::decide(header, length, &Maps { in_one_buffer }) {
        Verdict::Send(link, counter) => {
            packet.address(link);
            send(link, counter)
        }
        Verdict::Answer(link, counter) => {
            packet.address(link);
            if packet::cut(context, length - Header::LEN) { send(link, counter) } else { Outcome::Dropped(counter) }
        }
        Verdict::Copies(group) if copies::label(&mut packet, group) && groups::redirect(group) => {
            Outcome::Redirected(Counter::Replicated)
        }
        Verdict::Copies(_) => Outcome::Dropped(Counter::RedirectFailed),
        // The kernel leaves a notice to the daemon as well.
        Verdict::Notice(_) | Verdict::Slow => Outcome::Passed(Counter::Slow),
        Verdict::Drop(counter) => Outcome::Dropped(counter),
    }
}

#[inline(always)]
fn send(link: &LinkEntry, counter: Counter) -> Outcome {
    if ports::redirect(link.port) { Outcome::Redirected(counter) } else { Outcome::Dropped(Counter::RedirectFailed) }
}

#[inline(always)]
fn leave(context: &XdpContext) -> Departure {
    let here = context.data_end().saturating_sub(context.data());
    let Some(mut packet) = Packet::parse(context, here) else { return Departure::Ready };
    let label = packet.label();
    if !label.is_one() {
        return Departure::Ready;
    }
    // SAFETY: the context of a program that runs in a device map has the field.
    let interface = unsafe { (*context.ctx).egress_ifindex };
    let Some(place) = label.place(interface) else { return Departure::Superfluous };
    let Some(link) = groups::link_at(&place).and_then(links::get) else {
        return superfluous(context, packet, place);
    };
    let length = packet.frame_length();
    let Some(header) = packet.header() else { return Departure::Superfluous };
    let Some(ingress) = links::get(header.link_id()) else { return superfluous(context, packet, place) };
    match forward::copy(header, length, link, ingress, &Maps { in_one_buffer: true }) {
        Copy::Send(counter) => {
            packet.address(link);
            Departure::Copied(counter)
        }
        Copy::None => superfluous(context, packet, place),
        Copy::Drop(counter) => {
            counters::count(counter);
            superfluous(context, packet, place)
        }
    }
}

#[inline(always)]
fn superfluous(context: &XdpContext, mut packet: Packet, place: GroupPlace) -> Departure {
    let next = GroupPlace { index: place.index + 1, ..place };
    if groups::link_at(&next).is_some() {
        return Departure::Superfluous;
    }
    packet.become_filler();
    let length = packet.frame_length();
    if packet::cut(context, length - packet::FILLER_LEN) { Departure::Filler } else { Departure::Superfluous }
}

#[cfg(all(target_arch = "bpf", not(test)))]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}

/// On the host the crate only compiles, for lints and editors.
#[cfg(not(target_arch = "bpf"))]
fn main() {}
