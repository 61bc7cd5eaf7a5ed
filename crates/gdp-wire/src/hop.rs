//! The header fields that belong to the egress link of a frame.

use crate::{Header, LinkEntry};

/// Writes the fields of `link` into a frame that leaves by it, and the hop tag. `count` is the
/// number of frames sent on the link, including this one.
#[inline(always)]
pub fn stamp(header: &mut Header, link: &LinkEntry, count: u64) {
    let key = direct(header, link, count);
    header.set_tag(header.tag_for(key, count));
}

/// Writes the same fields as [`stamp`] except the hop tag. Returns the key for the tag.
#[inline(always)]
pub fn direct(header: &mut Header, link: &LinkEntry, count: u64) -> [u64; 2] {
    // Read once, because user space may change the phase concurrently and flag and key must match.
    // SAFETY: a field of a live entry.
    let second = unsafe { (&raw const link.tx_phase).read_volatile() } & 1 != 0;
    header.flags = header.flags & !Header::KEY_PHASE | if second { Header::KEY_PHASE } else { 0 };
    header.set_link_id(link.peer_id);
    header.set_link_counter(count as u32);
    if second { link.tx_keys[1] } else { link.tx_keys[0] }
}
