//! The forwarding decision. "Names at the edge, bits inside": the ingress switch looks the destination up and stamps
//! the egress switches as bits (after BIER, RFC 8279); a switch in transit only looks at bits; the egress switch finds
//! its own bit and looks the name up for its local link.

use crate::header::FrameType;
use crate::replay::{self, Words};
use crate::siphash::siphash24;
use crate::table::{ANY_WRITER, EGRESS_SET_SIZE, LinkRole, PORT_USERSPACE, Tables};
use crate::{Counter, Header, LinkEntry};

/// What a data plane must do with a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict<'t> {
    /// Send it by this link; the header has been rewritten for it.
    Send(&'t LinkEntry, Counter),
    /// Leave it, untouched, to the userspace plane; counted as [`Counter::Slow`].
    Slow,
    /// Drop it and count why.
    Drop(Counter),
}

/// What the first bytes of a frame say it is, before its header is read whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Data,
    Control,
    Unknown,
}

/// Tells data from control frames by the first byte.
#[inline(always)]
pub fn classify(first_byte: u8) -> Kind {
    if first_byte == FrameType::Data.first_byte() {
        Kind::Data
    } else if first_byte == FrameType::Control.first_byte() {
        Kind::Control
    } else {
        Kind::Unknown
    }
}

/// Which data plane asks: the kernel leaves links without a device to the userspace plane, which has no one to ask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Plane {
    Kernel,
    Userspace,
}

/// Decides what happens to a data frame of which `available` bytes are there, header included, and rewrites its header
/// for the next link. If the verdict is not [`Verdict::Send`], the header is unchanged.
#[inline(always)]
pub fn decide<'t, T: Tables>(header: &mut Header, available: usize, tables: &'t T, plane: Plane) -> Verdict<'t> {
    let (ingress, window, count) = match arrival(header, available, tables) {
        Ok(arrival) => arrival,
        Err(counter) => return Verdict::Drop(counter),
    };
    let route = route(header, available, ingress, tables);
    if let Ok((link, ..)) = &route
        && plane == Plane::Kernel
        && link.port == PORT_USERSPACE
    {
        // Whose window is the same: were the frame taken here, it would be refused there.
        return Verdict::Slow;
    }
    if !replay::take(&window, count) {
        return Verdict::Drop(Counter::Replayed);
    }
    match route {
        Ok((link, bits, set, counter)) => {
            header.hop_limit -= 1;
            header.egress_set = set;
            header.set_egress_bits(bits);
            stamp(header, link, tables.next_count(link));
            Verdict::Send(link, counter)
        }
        Err(counter) => Verdict::Drop(counter),
    }
}

/// Takes a data frame as an endpoint receives it on `link`: checks its form, that the neighbour sent it, and that it was not
/// taken before.
pub fn accept(header: &Header, available: usize, link: &LinkEntry, window: &impl Words) -> Result<(), Counter> {
    well_formed(header, available)?;
    if header.link_id() != link.id {
        return Err(Counter::NoLink);
    }
    let count = authentic(header, link, window)?;
    if replay::take(window, count) { Ok(()) } else { Err(Counter::Replayed) }
}

/// Writes the fields that belong to `link` into a frame that leaves by it, and the hop tag over the whole. `count`: frames
/// sent on the link, with this one.
#[inline(always)]
pub fn stamp(header: &mut Header, link: &LinkEntry, count: u64) {
    header.set_link_id(link.peer_id);
    header.set_link_counter(count as u32);
    header.set_tag(siphash24(link.tx_key, &header.tagged_words(count)));
}

/// The link a frame came in on, its replay window and the frame's count, if it is well-formed, authentic and not known.
#[inline(always)]
fn arrival<'t, T: Tables>(
    header: &Header,
    available: usize,
    tables: &'t T,
) -> Result<(&'t LinkEntry, impl Words + use<'t, T>, u64), Counter> {
    well_formed(header, available)?;
    let link = tables.link(header.link_id()).ok_or(Counter::NoLink)?;
    let window = tables.window(link).ok_or(Counter::NoLink)?;
    let count = authentic(header, link, &window)?;
    if replay::is_fresh(&window, count) { Ok((link, window, count)) } else { Err(Counter::Replayed) }
}

type Route<'t> = (&'t LinkEntry, u64, u8, Counter);

#[inline(always)]
fn route<'t, T: Tables>(
    header: &Header,
    available: usize,
    ingress: &LinkEntry,
    tables: &'t T,
) -> Result<Route<'t>, Counter> {
    if header.hop_limit <= 1 {
        return Err(Counter::HopLimit);
    }

    let from_edge = ingress.role == LinkRole::Endpoint as u32;
    let (bits, set) = if from_edge {
        if !header.source.is(&ingress.peer) {
            return Err(Counter::Source);
        }
        let entry = tables.route(&header.destination).ok_or(Counter::NoRoute)?;
        let listed = entry.writer_link == ingress.id || entry.writer_link == ANY_WRITER;
        let may_send = listed || entry.more_writers != 0 && tables.is_permitted(ingress, &header.destination);
        if !may_send {
            return Err(Counter::NotPermitted);
        }
        (entry.egress_bits, entry.egress_set as u8)
    } else {
        (header.egress_bits(), header.egress_set)
    };
    if bits == 0 {
        return Err(Counter::NoEgress);
    }

    let own = tables.own_bit();
    let (egress, bits, counter) = if bits & own != 0 {
        if bits != own {
            return Err(Counter::Replication);
        }
        let entry = tables.route(&header.destination).ok_or(Counter::NoRoute)?;
        let link = tables.link(entry.local_link).ok_or(Counter::NoRoute)?;
        (link, 0, Counter::Delivered)
    } else {
        let link = tables.link(tables.next_hop(lowest_bit(bits))).ok_or(Counter::NoEgress)?;
        if bits & !link.reach != 0 {
            return Err(Counter::Replication);
        }
        (link, bits, Counter::Forwarded)
    };

    if egress.id == ingress.id {
        return Err(Counter::Hairpin);
    }
    // All of it leaves, also what lies behind the payload.
    if available > egress.mtu as usize {
        return Err(Counter::TooBig);
    }
    Ok((egress, bits, set, counter))
}

#[inline(always)]
fn well_formed(header: &Header, available: usize) -> Result<(), Counter> {
    if header.version_type != FrameType::Data.first_byte() || header.header_words as usize * 8 != Header::LEN {
        return Err(Counter::Unknown);
    }
    if Header::LEN + header.payload_len() as usize > available {
        return Err(Counter::Truncated);
    }
    Ok(())
}

/// The frame's count on its link, if the neighbour made the tag.
#[inline(always)]
fn authentic(header: &Header, link: &LinkEntry, window: &impl Words) -> Result<u64, Counter> {
    let count = replay::whole(window, header.link_counter());
    let tag = siphash24(link.rx_key, &header.tagged_words(count));
    if tag == header.tag() { Ok(count) } else { Err(Counter::BadTag) }
}

/// Index of the lowest set bit of a value that is not zero.
#[inline(always)]
fn lowest_bit(bits: u64) -> u32 {
    bits.trailing_zeros() & (EGRESS_SET_SIZE - 1)
}
