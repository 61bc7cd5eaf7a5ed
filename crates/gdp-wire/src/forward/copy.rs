//! What becomes of a frame at each link of a group.

use super::is_foreign;
use crate::forward::rewrite::wait;
use crate::tables::Tables;
use crate::{Counter, Header, LinkEntry, LinkRole};

/// What a link of a group gets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Copy {
    /// The frame, with its header as it is now and what [`Tables::stamp`] has left for later.
    Send(Counter),
    /// Nothing: it is none of the frame's links.
    None,
    /// Nothing, and that is counted.
    Drop(Counter),
}

/// Makes the header of a frame that [`super::decide`] wants copied the one for `link`. `length`:
/// bytes of the frame; `ingress`: where the frame came in. Bits partition: each neighbour gets
/// those that it leads to, so nothing multiplies.
#[inline(always)]
pub fn copy<T: Tables>(header: &mut Header, length: usize, link: &LinkEntry, ingress: &LinkEntry, tables: &T) -> Copy {
    if link.id == ingress.id {
        return Copy::None;
    }
    let wanted = header.egress_bits();
    let (bits, counter) = if link.role == LinkRole::Switch as u32 {
        (wanted & link.reach, Counter::Forwarded)
    } else {
        (wanted & tables.own_bit(), Counter::Delivered)
    };
    if bits == 0 || link.role == LinkRole::Border as u32 && is_foreign(header, ingress) {
        return Copy::None;
    }
    if length > link.mtu as usize {
        return Copy::Drop(Counter::TooBig);
    }
    header.set_egress_bits(if link.role == LinkRole::Switch as u32 { bits } else { 0 });
    wait(header, link, tables);
    tables.stamp(header, link);
    Copy::Send(counter)
}
