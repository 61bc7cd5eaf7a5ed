//! The header changes of a forwarded frame.

use crate::forward::route::is_foreign;
use crate::tables::Tables;
use crate::{Header, LinkEntry, LinkRole};

/// Copies a router's congestion mark into the header, which carries the mark to the reader.
///
/// Returns `false` if the outer packet was marked and the frame's writer does not support marks.
/// Only a loss can signal congestion to such a writer (RFC 6040, section 4.2). `traffic` is the
/// byte of the outer packet.
///
/// Uses arithmetic: with branches for the mark and the writer's support, the kernel's verifier
/// would explore one and a half times as many states.
#[inline(always)]
pub fn carry_mark(header: &mut Header, traffic: u8) -> bool {
    let (marked, takes_marks) = (traffic & traffic >> 1 & 1, header.flags | header.flags >> 1);
    if marked & !takes_marks != 0 {
        return false;
    }
    header.flags |= marked << 1 | marked;
    true
}

/// Marks a frame that waits in a queue of `link`, if its writer supports marks.
#[inline(always)]
pub fn wait<T: Tables>(header: &mut Header, link: &LinkEntry, tables: &T) {
    if tables.has_queue(link) && header.flags & Header::ECN != 0 {
        header.flags |= Header::CONGESTED;
    }
}

/// Applies the header changes that do not depend on the egress link.
#[inline(always)]
pub fn rewrite_hop(header: &mut Header, ingress: &LinkEntry, bits: u64, set: u8) {
    header.hop_limit -= 1;
    header.egress_set = set;
    header.set_egress_bits(bits);
    if ingress.role != LinkRole::Switch as u32 {
        header.flags = header.flags & !Header::FOREIGN | if is_foreign(header, ingress) { Header::FOREIGN } else { 0 };
    }
}
