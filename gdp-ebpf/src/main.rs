//! The XDP programs of a switch. All decisions are in `gdp_wire::forward`. This crate does the
//! kernel's part: it finds the header in the packet, looks up BPF maps, carries out the verdict and
//! counts.
//!
//! Loaded by `gdp_dataplane::kernel`. Most modules are maps; each states who may write its map, and
//! when. [`packet`] and [`carrier`] handle the headers around a frame, and [`next_hop`] the
//! kernel's routing table. Only this file turns outcomes into XDP actions and counters.
//!
//! [`gdp_switch`] runs where a frame arrives, [`gdp_egress`] at the interface that the kernel sends
//! the frame on. [`gdp_egress`] exists for the copies of a frame. The kernel runs it on all frames
//! that leave by an interface, so where copies leave, every frame passes through it.
//!
//! Each of the two exists in two variants. [`gdp_switch`] and [`gdp_egress`] accept packets that
//! span several buffers (MTU above about 3500), which kernels before 5.18 do not support.
//! [`gdp_switch_linear`] and [`gdp_egress_linear`] run on those kernels. [`gdp_switch_linear`] is
//! also faster where packets are smaller, because it need not ask the kernel for their length.
#![cfg_attr(target_arch = "bpf", no_std, no_main, feature(asm_experimental_arch))]

mod carrier;
mod config;
mod copies;
mod counters;
mod fib;
mod groups;
mod host_pair;
mod links;
mod local;
mod losses;
mod next_hop;
mod next_hops;
mod opaque;
mod packet;
mod permits;
mod ports;
mod tables;
mod tally;
mod verifier;
mod windows;

use aya_ebpf::bindings::xdp_action::{XDP_DROP, XDP_PASS, XDP_REDIRECT};
use aya_ebpf::macros::xdp;
use aya_ebpf::programs::XdpContext;
use gdp_wire::forward::{self, Copy, Kind, Verdict};
use gdp_wire::packet::ETHERNET_LEN;
use gdp_wire::table::{MAX_COPIED_FRAME, PORT_ROUTED};
use gdp_wire::tables::Tables;
use gdp_wire::{Counter, GroupSlot, Header, LinkEntry};

use crate::carrier::FrameLocation;
use crate::carrier::ethernet::Ethernet;
use crate::copies::Label;
use crate::next_hop::NextHop;
use crate::packet::Packet;
use crate::tables::Maps;

/// The switch for packets that may span several buffers.
#[xdp(frags)]
pub fn gdp_switch(context: XdpContext) -> u32 {
    let length = packet::length(&context);
    act(&context, handle(&context, length))
}

/// The switch for packets in one buffer, and for kernels before 5.18.
#[xdp]
pub fn gdp_switch_linear(context: XdpContext) -> u32 {
    let length = context.data_end().saturating_sub(context.data());
    act(&context, handle(&context, length))
}

/// The egress program, on kernels from 5.18 on.
#[xdp(frags, map = "devmap")]
pub fn gdp_egress(context: XdpContext) -> u32 {
    act_at_egress(leave(&context))
}

/// The egress program, on older kernels.
#[xdp(map = "devmap")]
pub fn gdp_egress_linear(context: XdpContext) -> u32 {
    act_at_egress(leave(&context))
}

/// Returns the egress interface of a link over UDP, or 0. Never attached: user space runs it. The
/// packet begins with the id of the link. The result is the interface that [`gdp_egress`] would
/// find for the largest frame that it gets for the link.
#[xdp]
pub fn gdp_route(context: XdpContext) -> u32 {
    route(&context).unwrap_or(0)
}

/// For the interface of an endpoint on a veth. A veth takes redirected frames only if its other end
/// runs a program (or has GRO on).
#[xdp(frags)]
pub fn gdp_pass(_context: XdpContext) -> u32 {
    XDP_PASS
}

/// The outcome for a packet.
enum Outcome {
    /// The packet is redirected to another interface.
    Redirected(Counter),
    /// The packet goes to the host, unchanged except by [`host_pair`].
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

/// The outcome for a packet at egress.
enum Departure {
    /// The packet was already addressed to its link at ingress.
    Ready,
    /// The packet is a copy, now addressed to its link.
    Copied(Counter),
    /// The packet is a copy that no link needs.
    Superfluous,
    /// The packet is a superfluous copy, the last at its interface, and was replaced by a frame
    /// that no host accepts. See [`copies`].
    Filler,
}

#[inline(always)]
fn act_at_egress(departure: Departure) -> u32 {
    match departure {
        Departure::Ready | Departure::Filler => XDP_PASS,
        Departure::Copied(counter) => {
            counters::count(counter);
            XDP_PASS
        }
        Departure::Superfluous => XDP_DROP,
    }
}

#[inline(always)]
fn handle(context: &XdpContext, length: usize) -> Outcome {
    let packet = Packet::of(context);
    if packet.get::<Ethernet>(0).is_none() {
        return Outcome::Dropped(Counter::Truncated);
    }
    let Some(carried) = carrier::locate(context, &packet, length, config::get().ethertype) else {
        return Outcome::Passed(Counter::Foreign);
    };
    let mut frame = packet.from(carried.at);
    // Padding may follow an empty datagram.
    let Some(first_byte) = frame.get::<u8>(0).filter(|_| carried.available > 0) else {
        return Outcome::Dropped(Counter::Truncated);
    };
    // SAFETY: `get` checked the bounds.
    let first_byte = unsafe { *first_byte };
    if carrier::is_quic(&carried, first_byte) {
        return Outcome::Passed(Counter::Control);
    }
    match forward::classify(first_byte) {
        Kind::Headed => match frame.header(0) {
            Some(header) => forward_frame(context, header, carried, length),
            None => Outcome::Dropped(Counter::Truncated),
        },
        Kind::Control => Outcome::Passed(Counter::Control),
        Kind::Unknown => Outcome::Dropped(Counter::Unknown),
    }
}

#[inline(always)]
fn forward_frame(context: &XdpContext, header: &mut Header, carried: FrameLocation, length: usize) -> Outcome {
    let (ingress, tag) = (header.link_id(), header.tag());
    let outcome = forward_headed(context, header, tag, carried, length);
    tally::count_arrival(ingress, outcome.counter());
    outcome
}

#[inline(always)]
fn forward_headed(
    context: &XdpContext,
    header: &mut Header,
    tag: u64,
    carried: FrameLocation,
    length: usize,
) -> Outcome {
    let in_one_buffer = length == context.data_end() - context.data();
    let tables = Maps { context, length: header.frame_len(), unknown: tag, in_one_buffer };
    let traffic = carrier::traffic(&Packet::of(context), &carried);
    let verdict = forward::decide(header, carried.available, traffic, &tables);
    // An answer has no payload, so this is also the length of an answer.
    let frame = header.frame_len();
    let behind = length - carried.at - frame;
    let (link, hop, counter) = match verdict {
        Verdict::Send(link, hop, counter) => {
            tally::sample(tag, header);
            (link, hop, counter)
        }
        Verdict::Answer(link, hop, counter) => (link, hop, counter),
        Verdict::Copies(group) => {
            tally::sample(tag, header);
            return replicate(context, group, carried.at, behind);
        }
        // The kernel also hands a notice to the daemon.
        Verdict::Notice(_) | Verdict::Slow => return Outcome::Passed(Counter::Slow),
        Verdict::Drop(counter) => return Outcome::Dropped(counter),
    };
    let traffic = Header::ip_traffic(header.flags);
    if !carrier::exchange(context, carried.at, frame, behind, traffic, link, &hop) {
        return Outcome::Dropped(Counter::RedirectFailed);
    }
    if ports::redirect(hop.port) { Outcome::Redirected(counter) } else { Outcome::Dropped(Counter::RedirectFailed) }
}

/// Makes the kernel copy the frame at offset `at`, without the `behind` bytes after it. [`leave`]
/// then addresses each copy to its link.
#[inline(always)]
fn replicate(context: &XdpContext, group: u32, at: usize, behind: usize) -> Outcome {
    let bare = packet::cut(context, behind) && packet::shift(context, at, ETHERNET_LEN);
    if bare && copies::label(&Packet::of(context), group) && groups::redirect(group) {
        Outcome::Redirected(Counter::Replicated)
    } else {
        Outcome::Dropped(Counter::RedirectFailed)
    }
}

#[inline(always)]
fn leave(context: &XdpContext) -> Departure {
    let mut packet = Packet::of(context);
    let Some(label) = Label::of(&packet) else { return Departure::Ready };
    // SAFETY: the context of a program in a device map has this field.
    let interface = unsafe { (*context.ctx).egress_ifindex };
    let Some(slot) = label.slot(interface) else { return Departure::Superfluous };
    let Some(header) = packet.header(ETHERNET_LEN) else { return Departure::Superfluous };
    match copy(context, header, slot) {
        Some(counter) => Departure::Copied(counter),
        None => superfluous(context, slot),
    }
}

/// Addresses a copy to the link of its slot. Returns the counter of the copy, or `None` if it is
/// not sent.
#[inline(always)]
fn copy(context: &XdpContext, header: &mut Header, slot: GroupSlot) -> Option<Counter> {
    let link: &LinkEntry = groups::link_at(&slot).and_then(links::get)?;
    let ingress = links::get(header.link_id())?;
    let frame = header.frame_len();
    let tables = Maps { context, length: frame, unknown: header.tag(), in_one_buffer: true };
    let counter = match forward::copy(header, frame, link, ingress, &tables) {
        Copy::Send(counter) => counter,
        Copy::None => return None,
        Copy::Drop(counter) => {
            counters::count(counter);
            return None;
        }
    };
    let traffic = Header::ip_traffic(header.flags);
    let can_ask = link.port != PORT_ROUTED || next_hop::asks_at_egress();
    let mut hop = NextHop::default();
    let leaves_here = can_ask && tables.resolve(link, &mut hop) && hop.port == slot.interface;
    if leaves_here && carrier::exchange(context, ETHERNET_LEN, frame, 0, traffic, link, &hop) {
        return Some(counter);
    }
    if link.port == PORT_ROUTED {
        groups::suspend(slot.group);
    }
    counters::count(Counter::RedirectFailed);
    None
}

#[inline(always)]
fn route(context: &XdpContext) -> Option<u32> {
    let id = Packet::of(context).get::<u32>(0)?;
    // SAFETY: `get` checked the bounds.
    let link = links::get(unsafe { *id })?;
    let length = (link.mtu as usize).min(MAX_COPIED_FRAME);
    let mut hop = NextHop::default();
    let is_routed = next_hop::asks_at_egress() && link.port == PORT_ROUTED;
    (is_routed && next_hop::look_up(context, link, length, &mut hop)).then_some(hop.port)
}

#[inline(always)]
fn superfluous(context: &XdpContext, slot: GroupSlot) -> Departure {
    let next = GroupSlot { index: slot.index + 1, ..slot };
    if groups::link_at(&next).is_none() && copies::make_discardable(context) {
        Departure::Filler
    } else {
        copies::count_superfluous(slot.interface);
        Departure::Superfluous
    }
}

#[cfg(all(target_arch = "bpf", not(test)))]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}

/// On the host, the crate compiles only for lints and editors.
#[cfg(not(target_arch = "bpf"))]
fn main() {}
