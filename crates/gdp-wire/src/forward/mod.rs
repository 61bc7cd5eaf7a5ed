//! The forwarding decision. "Names at the edge, bits inside": the ingress switch looks the destination up and stamps
//! the egress switches as bits (after BIER, RFC 8279); a switch in transit only looks at bits; the egress switch finds
//! its own bit and looks the name up for its local links.
//!
//! [`decide`] is the order of things; [`arrival`], [`route`], [`probe`] and [`answer`] are its parts, and [`copy()`] is what it leaves
//! to be done for each link of a group.

mod answer;
mod arrival;
mod copy;
mod probe;
mod route;

pub use arrival::{accept, keyed};
pub use copy::{Copy, copy};

use crate::header::FrameType;
use crate::replay;
use crate::table::Tables;
use crate::{Counter, Header, LinkEntry, LinkRole};

use arrival::{Arrival, arrival};
use route::{Egress, Refusal, is_foreign, route};

/// What a data plane must do with a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict<'t> {
    /// Send it by this link; the header has been rewritten for it, but for what [`Tables::stamp`] has left for later.
    Send(&'t LinkEntry, Counter),
    /// For each link of this group that [`copy()`] says so, send what that makes of it; count it as
    /// [`Counter::Replicated`].
    Copies(u32),
    /// The header has become an answer to the neighbour: send it by this link, without a payload.
    Answer(&'t LinkEntry, Counter),
    /// It is for this node itself, unchanged: an error, the answer to an echo, or a probe that ends here; counted as [`Counter::Notice`].
    Notice(&'t LinkEntry),
    /// Leave it, untouched, to the next plane; counted as [`Counter::Slow`].
    Slow,
    /// Drop it and count why.
    Drop(Counter),
}

/// What the first bytes of a frame say it is, before its header is read whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Has a [`Header`]: for [`decide`], or [`accept`].
    Headed,
    Control,
    Unknown,
}

/// Tells frames apart by the first byte.
#[inline(always)]
pub fn classify(first_byte: u8) -> Kind {
    match frame_type(first_byte) {
        Some(FrameType::Control) => Kind::Control,
        Some(_) => Kind::Headed,
        None => Kind::Unknown,
    }
}

/// Decides what happens to a frame of which `available` bytes are there, header included, and rewrites its header
/// accordingly. `traffic`: the byte that IP has for DSCP and ECN in what carried it, of which only a router's mark counts (CE,
/// RFC 3168); 0 on Ethernet. What lies behind the payload, as Ethernet pads short frames, is no part of the frame: whoever carries
/// the verdict out leaves it behind. If the verdict is [`Verdict::Notice`], [`Verdict::Slow`] or [`Verdict::Drop`], the header is unchanged.
#[inline(always)]
pub fn decide<'t, T: Tables>(header: &mut Header, available: usize, traffic: u8, tables: &'t T) -> Verdict<'t> {
    let Arrival { link: ingress, window, count } = match arrival(header, available, tables) {
        Ok(arrival) => arrival,
        Err(counter) => return Verdict::Drop(counter),
    };
    let fate = fate(header, ingress, tables);
    // What is left to another plane is left as it came. Its window is the same: taken here, it would be refused there.
    if !T::LAST && !is_for_this_plane(&fate, header.frame_len(), tables) {
        return Verdict::Slow;
    }
    if !replay::take(&window, count) {
        return Verdict::Drop(Counter::Replayed);
    }
    match fate.what {
        What::Send => {
            if !carry_mark(header, traffic) {
                return Verdict::Drop(Counter::Congested);
            }
            travel(header, ingress, fate.bits, fate.set);
            wait(header, fate.link, tables);
            tables.stamp(header, fate.link);
            Verdict::Send(fate.link, fate.counter)
        }
        What::Copy => {
            if !carry_mark(header, traffic) {
                return Verdict::Drop(Counter::Congested);
            }
            travel(header, ingress, fate.bits, fate.set);
            Verdict::Copies(fate.group)
        }
        What::Refuse => answer::complain(header, fate.refusal, ingress, tables),
        What::Echo => answer::echo(header, ingress, tables),
        What::Notice => Verdict::Notice(ingress),
        What::Punt => {
            tables.punt(ingress);
            Verdict::Notice(ingress)
        }
    }
}

/// What is to be done with a frame, before this plane knows whether it is the one to do it.
///
/// Every field always holds something. Where an enum leaves one out, the compiler spills a register that nothing was written to
/// when a plane's answer is a call, and the kernel's verifier refuses that.
struct Fate<'t> {
    what: What,
    /// Where it leaves; the one it came by, if it leaves by none.
    link: &'t LinkEntry,
    group: u32,
    bits: u64,
    set: u8,
    counter: Counter,
    refusal: Refusal,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum What {
    Send,
    Copy,
    Refuse,
    Echo,
    Notice,
    /// As a notice, but not more often than may be.
    Punt,
}

#[inline(always)]
fn fate<'t, T: Tables>(header: &Header, ingress: &'t LinkEntry, tables: &'t T) -> Fate<'t> {
    let refusal = Refusal { counter: Counter::Unknown, code: None, mtu: 0 };
    let none = Fate { what: What::Notice, link: ingress, group: 0, bits: 0, set: 0, counter: Counter::Notice, refusal };
    if header.version_type == FrameType::Data.first_byte() {
        match route(header, header.frame_len(), ingress, tables) {
            Ok(Egress::One { link, bits, set, counter }) => Fate { what: What::Send, link, bits, set, counter, ..none },
            Ok(Egress::Many { group, bits, set }) => Fate { what: What::Copy, group, bits, set, ..none },
            Err(refusal) => {
                let refusal = answer::as_told(refusal, header, ingress, tables);
                Fate { what: What::Refuse, refusal, ..none }
            }
        }
    } else if header.version_type == FrameType::Probe.first_byte() {
        match probe::next(header, ingress, tables) {
            Ok(Some(link)) => {
                let (bits, set, counter) = (header.egress_bits(), header.egress_set, Counter::Forwarded);
                Fate { what: What::Send, link, bits, set, counter, ..none }
            }
            Ok(None) => Fate { what: What::Punt, ..none },
            Err(counter) => Fate { what: What::Refuse, refusal: counter.into(), ..none },
        }
    } else if header.version_type == FrameType::Echo.first_byte() && header.egress_set == Header::ASKS {
        Fate { what: What::Echo, ..none }
    } else if header.version_type == FrameType::Error.first_byte() && ingress.role == LinkRole::Endpoint as u32 {
        // Nothing is sent to an endpoint that it could refuse.
        Fate { what: What::Refuse, ..none }
    } else {
        none
    }
}

#[inline(always)]
fn is_for_this_plane<T: Tables>(fate: &Fate<'_>, length: usize, tables: &T) -> bool {
    match fate.what {
        What::Send | What::Echo => tables.can_send(fate.link),
        What::Copy => tables.can_copy(fate.group, fate.bits, length),
        What::Refuse => fate.refusal.code.is_none() || tables.can_send(fate.link),
        What::Notice | What::Punt => false,
    }
}

/// Writes the fields that belong to `link` into a frame that leaves by it, and the hop tag over the whole. `count`: frames
/// sent on the link, with this one.
#[inline(always)]
pub fn stamp(header: &mut Header, link: &LinkEntry, count: u64) {
    let key = direct(header, link, count);
    header.set_tag(header.tag_for(key, count));
}

/// As [`stamp`], but for the hop tag; the key of that.
#[inline(always)]
pub fn direct(header: &mut Header, link: &LinkEntry, count: u64) -> [u64; 2] {
    // Once, although user space may change it meanwhile: flag and key must be of the same phase.
    // SAFETY: a field of a live entry.
    let second = unsafe { (&raw const link.tx_phase).read_volatile() } & 1 != 0;
    header.flags = header.flags & !Header::KEY_PHASE | if second { Header::KEY_PHASE } else { 0 };
    header.set_link_id(link.peer_id);
    header.set_link_counter(count as u32);
    if second { link.tx_keys[1] } else { link.tx_keys[0] }
}

/// Takes a router's mark over into the header, which goes all the way to the reader; `false` if what carried the frame was marked,
/// and its writer does not take marks, so that only a loss tells it (RFC 6040, section 4.2). `traffic`: of what carried it.
///
/// By arithmetic: with a branch for the mark and one for who takes it, the kernel's verifier would look at half as many states again.
#[inline(always)]
fn carry_mark(header: &mut Header, traffic: u8) -> bool {
    let (marked, takes_marks) = (traffic & traffic >> 1 & 1, header.flags | header.flags >> 1);
    if marked & !takes_marks != 0 {
        return false;
    }
    header.flags |= marked << 1 | marked;
    true
}

/// Marks a frame that waits long before it leaves by `link`, if it takes marks.
#[inline(always)]
fn wait<T: Tables>(header: &mut Header, link: &LinkEntry, tables: &T) {
    if tables.has_queue(link) && header.flags & Header::ECN != 0 {
        header.flags |= Header::CONGESTED;
    }
}

/// What changes in a frame on its way through a switch, whatever link it leaves by.
#[inline(always)]
fn travel(header: &mut Header, ingress: &LinkEntry, bits: u64, set: u8) {
    header.hop_limit -= 1;
    header.egress_set = set;
    header.set_egress_bits(bits);
    if ingress.role != LinkRole::Switch as u32 {
        header.flags = header.flags & !Header::FOREIGN | if is_foreign(header, ingress) { Header::FOREIGN } else { 0 };
    }
}

#[inline(always)]
fn frame_type(first_byte: u8) -> Option<FrameType> {
    const DATA: u8 = FrameType::Data.first_byte();
    const CONTROL: u8 = FrameType::Control.first_byte();
    const ERROR: u8 = FrameType::Error.first_byte();
    const PROBE: u8 = FrameType::Probe.first_byte();
    const ECHO: u8 = FrameType::Echo.first_byte();
    match first_byte {
        DATA => Some(FrameType::Data),
        CONTROL => Some(FrameType::Control),
        ERROR => Some(FrameType::Error),
        PROBE => Some(FrameType::Probe),
        ECHO => Some(FrameType::Echo),
        _ => None,
    }
}
