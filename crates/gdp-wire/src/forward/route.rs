//! The route of a data frame: one link, or the links of a group. Changes nothing.

use crate::header::ErrorCode;
use crate::table::{ANY_WRITER, EGRESS_SET_SIZE, NEIGHBOURS};
use crate::tables::Tables;
use crate::{Counter, Header, LinkEntry, LinkRole, Permit};

/// The egress of a frame.
pub enum Egress<'t> {
    One { link: &'t LinkEntry, bits: u64, set: u8, counter: Counter },
    Many { group: u32, bits: u64, set: u8 },
}

/// The reason that a frame is dropped, and the error for its neighbour.
pub struct Refusal {
    pub counter: Counter,
    pub code: Option<ErrorCode>,
    /// MTU of the link that the frame did not fit; otherwise 0.
    pub mtu: u32,
}

impl Refusal {
    #[inline(always)]
    fn disclosed(counter: Counter, code: ErrorCode) -> Self {
        Self { counter, code: Some(code), mtu: 0 }
    }
}

impl From<Counter> for Refusal {
    #[inline(always)]
    fn from(counter: Counter) -> Self {
        Self { counter, code: None, mtu: 0 }
    }
}

#[inline(always)]
pub fn route<'t, T: Tables>(
    header: &Header,
    length: usize,
    ingress: &LinkEntry,
    tables: &'t T,
) -> Result<Egress<'t>, Refusal> {
    if header.hop_limit <= 1 {
        return Err(Refusal::disclosed(Counter::HopLimit, ErrorCode::HopLimit));
    }
    let (bits, set) = if ingress.role == LinkRole::Switch as u32 {
        (header.egress_bits(), header.egress_set)
    } else {
        looked_up(header, ingress, tables)?
    };
    if bits == 0 {
        return Err(Refusal::disclosed(Counter::NoEgress, ErrorCode::NoRoute));
    }

    let own = tables.own_bit();
    let rest = bits & !own;
    if bits == rest {
        return match tables.link(tables.next_hop(lowest_bit(bits))) {
            Some(link) if rest & !link.reach == 0 => {
                checked(Egress::One { link, bits, set, counter: Counter::Forwarded }, header, length, ingress)
            }
            None if rest & (rest - 1) == 0 => Err(Refusal::disclosed(Counter::NoEgress, ErrorCode::NoRoute)),
            _ => Ok(Egress::Many { group: NEIGHBOURS, bits, set }),
        };
    }
    match tables.route(&header.destination) {
        Some(entry) => match tables.link(entry.local_link) {
            Some(link) if rest == 0 => {
                checked(Egress::One { link, bits: 0, set, counter: Counter::Delivered }, header, length, ingress)
            }
            // The name has no local reader, or its reader has just left.
            None if rest == 0 && (entry.group == NEIGHBOURS || entry.local_link != 0) => {
                Err(Refusal::disclosed(Counter::NoRoute, ErrorCode::NoRoute))
            }
            _ => Ok(Egress::Many { group: entry.group, bits, set }),
        },
        None if rest == 0 => Err(Refusal::disclosed(Counter::NoRoute, ErrorCode::NoRoute)),
        None => Ok(Egress::Many { group: NEIGHBOURS, bits: rest, set }),
    }
}

/// Returns the egress bits and set of the frame's name, if the link may send to this name from this
/// source.
#[inline(always)]
fn looked_up<T: Tables>(header: &Header, ingress: &LinkEntry, tables: &T) -> Result<(u64, u8), Refusal> {
    let may_be_source = if ingress.role == LinkRole::Endpoint as u32 {
        header.source.is(&ingress.peer)
    } else {
        tables.is_permitted(&Permit { name: header.source, link: ingress.id, part: Permit::SOURCE })
    };
    if !may_be_source {
        // No error, because the hop tag does not cover the source: an honest neighbour would be
        // told what somebody else has done.
        return Err(Counter::Source.into());
    }
    let entry = tables.route(&header.destination).ok_or(Refusal::disclosed(Counter::NoRoute, ErrorCode::NoRoute))?;
    let listed = entry.writer_link == ingress.id || entry.writer_link == ANY_WRITER;
    let permit = || Permit { name: header.destination, link: ingress.id, part: Permit::DESTINATION };
    if !listed && (entry.more_writers == 0 || !tables.is_permitted(&permit())) {
        return Err(Refusal::disclosed(Counter::NotPermitted, ErrorCode::NotAuthorised));
    }
    Ok((entry.egress_bits, entry.egress_set))
}

/// Checks that the frame may and can leave by the one link.
#[inline(always)]
fn checked<'t>(egress: Egress<'t>, header: &Header, length: usize, ingress: &LinkEntry) -> Result<Egress<'t>, Refusal> {
    let Egress::One { link, .. } = &egress else { return Ok(egress) };
    if link.id == ingress.id {
        return Err(Counter::Hairpin.into());
    }
    if link.role == LinkRole::Border as u32 && is_foreign(header, ingress) {
        return Err(Counter::SplitHorizon.into());
    }
    if length > link.mtu as usize {
        return Err(Refusal { counter: Counter::TooBig, code: Some(ErrorCode::TooBig), mtu: link.mtu });
    }
    Ok(egress)
}

/// Returns whether a frame came from another domain, at this or another switch of this domain, and
/// must not go on to a third.
#[inline(always)]
pub fn is_foreign(header: &Header, ingress: &LinkEntry) -> bool {
    ingress.role == LinkRole::Border as u32 && ingress.flags & LinkEntry::TRANSIT == 0
        || ingress.role == LinkRole::Switch as u32 && header.flags & Header::FOREIGN != 0
}

/// Returns the index of the lowest set bit. `bits` must not be zero.
#[inline(always)]
pub fn lowest_bit(bits: u64) -> u32 {
    bits.trailing_zeros() & (EGRESS_SET_SIZE - 1)
}
