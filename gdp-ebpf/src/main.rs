//! The XDP programs of a switch. Everything that decides is in `gdp_wire::forward`; here is only what the kernel needs
//! done around it: find the header in the packet, look up in BPF maps, carry the verdict out, count.
//!
//! Loaded by `gdp_ctl::plane::kernel`. The modules are the maps, each with the rule of who may write it when, and
//! [`packet`]. Only this file turns outcomes into XDP actions and counters.
//!
//! Two programs do the same: [`gdp_switch`] takes packets that span several buffers (MTU above about 3500), which
//! kernels before 5.18 cannot; for those there is [`gdp_switch_linear`].
#![cfg_attr(target_arch = "bpf", no_std, no_main, feature(asm_experimental_arch))]

mod config;
mod counters;
mod fib;
mod links;
mod next_hops;
mod losses;
mod packet;
mod permits;
mod ports;
mod tables;
mod windows;

use aya_ebpf::bindings::xdp_action::{XDP_DROP, XDP_PASS, XDP_REDIRECT};
use aya_ebpf::macros::xdp;
use aya_ebpf::programs::XdpContext;
use gdp_wire::forward::{self, Kind, Verdict};
use gdp_wire::{Counter, Header, LinkEntry};

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
    let length = packet.frame_length();
    let Some(header) = packet.header() else { return Outcome::Dropped(Counter::Truncated) };
    match forward::decide(header, length, &Maps) {
        Verdict::Send(link, counter) => {
            packet.address(link);
            send(link, counter)
        }
        Verdict::Answer(link, counter) => {
            packet.address(link);
            if packet::cut(context, length - Header::LEN) { send(link, counter) } else { Outcome::Dropped(counter) }
        }
        // The kernel leaves these to the daemon, so they do not come up.
        Verdict::Notice(_) | Verdict::Copies(_) | Verdict::Slow => Outcome::Passed(Counter::Slow),
        Verdict::Drop(counter) => Outcome::Dropped(counter),
    }
}

#[inline(always)]
fn send(link: &LinkEntry, counter: Counter) -> Outcome {
    if ports::redirect(link.port) { Outcome::Redirected(counter) } else { Outcome::Dropped(Counter::RedirectFailed) }
}

#[cfg(all(target_arch = "bpf", not(test)))]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}

/// On the host the crate only compiles, for lints and editors.
#[cfg(not(target_arch = "bpf"))]
fn main() {}
