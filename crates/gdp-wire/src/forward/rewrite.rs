//! What changes in the header of a frame that a switch forwards.

use crate::forward::route::is_foreign;
use crate::tables::Tables;
use crate::{Header, LinkEntry, LinkRole};

/// Copies a router's congestion mark into the header, which goes all the way to the reader.
///
/// Returns `false` if the outer packet was marked and the frame's writer takes no marks: only a
/// loss can tell such a writer (RFC 6040, section 4.2). `traffic` is the byte of the outer packet.
///
/// By arithmetic: with a branch for the mark and one for who takes it, the kernel's verifier would
/// look at half as many states again.
#[inline(always)]
pub fn carry_mark(header: &mut Header, traffic: u8) -> bool {
    let (marked, takes_marks) = (traffic & traffic >> 1 & 1, header.flags | header.flags >> 1);
    if marked & !takes_marks != 0 {
        return false;
    }
    header.flags |= marked << 1 | marked;
    true
}

/// Marks a frame that waits long before it leaves by `link`, if it takes marks.
#[inline(always)]
pub fn wait<T: Tables>(header: &mut Header, link: &LinkEntry, tables: &T) {
    if tables.has_queue(link) && header.flags & Header::ECN != 0 {
        header.flags |= Header::CONGESTED;
    }
}

/// What changes in a frame on its way through a switch, whatever link it leaves by.
#[inline(always)]
pub fn rewrite_hop(header: &mut Header, ingress: &LinkEntry, bits: u64, set: u8) {
    header.hop_limit -= 1;
    header.egress_set = set;
    header.set_egress_bits(bits);
    if ingress.role != LinkRole::Switch as u32 {
        header.flags = header.flags & !Header::FOREIGN | if is_foreign(header, ingress) { Header::FOREIGN } else { 0 };
    }
}
