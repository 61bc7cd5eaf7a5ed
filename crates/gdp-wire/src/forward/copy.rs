//! The decision for each link of a group.

use super::is_foreign;
use crate::forward::rewrite::wait;
use crate::tables::Tables;
use crate::{Counter, Header, LinkEntry, LinkRole};

/// The copy for a link of a group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Copy {
    /// Send the frame with its present header, after the deferred part of [`Tables::stamp`].
    Send(Counter),
    /// No copy: the frame is not for this link.
    None,
    /// No copy, and the drop is counted.
    Drop(Counter),
}

/// Rewrites the header of a frame for `link`, after [`super::decide`] returned copies. `length` is
/// that of the frame in bytes, `ingress` the link it arrived on. Each neighbour gets only the
/// egress bits that it leads to, so frames never multiply.
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
