//! The checks of a frame before any lookup: form, link, hop tag, and replay window.

use super::FrameType;
use super::frame_type::frame_type;
use crate::replay::{self, Words};
use crate::tables::Tables;
use crate::{Counter, Header, LinkEntry};

/// A frame from an authenticated neighbour.
pub struct Arrival<'t, W> {
    pub link: &'t LinkEntry,
    pub window: W,
    /// The whole count of the frame on its link.
    pub count: u64,
}

/// Returns the link of a frame, its replay window and the frame's count, if the frame is
/// well-formed, authentic and fresh.
#[inline(always)]
pub fn arrival<'t, T: Tables>(
    header: &Header,
    available: usize,
    tables: &'t T,
) -> Result<Arrival<'t, impl Words + use<'t, T>>, Counter> {
    well_formed(header, available)?;
    let link = tables.link(header.link_id()).ok_or(Counter::NoLink)?;
    let window = tables.window(link).ok_or(Counter::NoLink)?;
    let count = authentic(header, link, &window, |key, count| tables.has_tag(header, key, count))?;
    if replay::is_fresh(&window, count) { Ok(Arrival { link, window, count }) } else { Err(Counter::Replayed) }
}

/// Accepts a frame that an endpoint receives on `link`. Checks that the frame is well-formed,
/// authentic and fresh. Returns its type, which is never a control frame.
pub fn accept(header: &Header, available: usize, link: &LinkEntry, window: &impl Words) -> Result<FrameType, Counter> {
    let frame_type = well_formed(header, available)?;
    if header.link_id() != link.id {
        return Err(Counter::NoLink);
    }
    let count = authentic(header, link, window, |key, count| header.tag_for(key, count) == header.tag())?;
    if replay::take(window, count) { Ok(frame_type) } else { Err(Counter::Replayed) }
}

#[inline(always)]
fn well_formed(header: &Header, available: usize) -> Result<FrameType, Counter> {
    let frame_type = match frame_type(header.version_type) {
        Some(FrameType::Control) | None => return Err(Counter::Unknown),
        Some(frame_type) => frame_type,
    };
    // Checked first: in a padded datagram, part of the header may be padding.
    if header.frame_len() > available {
        return Err(Counter::Truncated);
    }
    if header.header_words as usize * 8 != Header::LEN {
        return Err(Counter::Unknown);
    }
    Ok(frame_type)
}

/// Returns the frame's count on its link, if the neighbour made the tag.
#[inline(always)]
fn authentic(
    header: &Header,
    link: &LinkEntry,
    window: &impl Words,
    has_tag: impl FnOnce([u64; 2], u64) -> bool,
) -> Result<u64, Counter> {
    let (key, count) = keyed(header, link, window);
    // An entry that is being written or removed may have no key. The zero key is public.
    if key == [0; 2] {
        return Err(Counter::BadTag);
    }
    if has_tag(key, count) { Ok(count) } else { Err(Counter::BadTag) }
}

/// Returns the key of a frame's tag, and the frame's whole count on its link if it is authentic.
#[inline(always)]
pub fn keyed(header: &Header, link: &LinkEntry, window: &impl Words) -> ([u64; 2], u64) {
    let count = replay::whole(window, header.link_counter());
    (if header.flags & Header::KEY_PHASE != 0 { link.rx_keys[1] } else { link.rx_keys[0] }, count)
}
