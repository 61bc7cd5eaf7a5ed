//! The fields of a header that belong to the link it leaves by.

use crate::{Header, LinkEntry};

/// Writes the fields that belong to `link` into a frame that leaves by it, and the hop tag over the
/// whole. `count`: frames sent on the link, with this one.
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
