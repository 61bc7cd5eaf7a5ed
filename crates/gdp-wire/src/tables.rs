//! The tables of a data plane, as the forwarding decision reads them.

use crate::table::{FibEntry, LinkEntry, Permit};
use crate::{Header, Name, hop, replay};

/// What [`crate::forward::decide`] asks of a data plane. Lookups must be bounded and must not
/// block.
pub trait Tables {
    /// Whether there is no other plane to leave a frame to.
    const LAST: bool;

    /// Where a frame leaves, as far as that is not known from its link.
    type NextHop: Copy + Default;

    /// The link with this id, if it is live.
    fn link(&self, id: u32) -> Option<&LinkEntry>;

    /// Where this name leads.
    fn route(&self, name: &Name) -> Option<FibEntry>;

    /// Link id of the neighbour on the path to egress switch `bit` (0 … 63); 0 if there is none.
    fn next_hop(&self, bit: u32) -> u32;

    /// This switch's own egress bit.
    fn own_bit(&self) -> u64;

    /// Whether there is such a [`Permit`].
    fn is_permitted(&self, permit: &Permit) -> bool;

    /// What frames have arrived on this link, shared by all planes that take frames from it.
    fn window(&self, link: &LinkEntry) -> Option<impl replay::Words>;

    /// The count for a frame that leaves by this link: 1 for the first.
    fn next_count(&self, link: &LinkEntry) -> u64;

    /// Whether a frame has the hop tag that its header and its whole `count` on the link make under
    /// `key`. For planes that check the tags of many frames at once.
    #[inline(always)]
    fn has_tag(&self, header: &Header, key: [u64; 2], count: u64) -> bool {
        header.tag_for(key, count) == header.tag()
    }

    /// Writes what belongs to `link` into the header of the next frame that leaves by it, or sees
    /// to it that this is done before the frame leaves. For planes that make the tags of many
    /// frames at once.
    #[inline(always)]
    fn stamp(&self, header: &mut Header, link: &LinkEntry) {
        hop::stamp(header, link, self.next_count(link));
    }

    /// Whether this plane can send by the link now, with `hop` as where to. Asked only of a plane
    /// that is not the last.
    fn resolve(&self, link: &LinkEntry, hop: &mut Self::NextHop) -> bool;

    /// Whether this plane can copy a frame of `length` bytes to those links of a group that `bits`
    /// lead to. Asked only of a plane that is not the last.
    fn can_copy(&self, group: u32, bits: u64, length: usize) -> bool;

    /// Whether frames wait long in this plane before they leave by the link: then those that take
    /// marks are marked.
    fn has_queue(&self, link: &LinkEntry) -> bool;

    /// Whether an error may go to the neighbour on this link now: [`COMPLAINT_INTERVAL_NS`] after
    /// the last.
    fn may_send_error(&self, link: &LinkEntry) -> bool;

    /// Says that an error goes to the neighbour on this link now.
    fn send_error(&self, link: &LinkEntry);

    /// Whether the daemon may be given a probe from the neighbour on this link now:
    /// [`PUNT_INTERVAL_NS`] after the last.
    fn may_punt(&self, link: &LinkEntry) -> bool;

    /// Says that the daemon is given one now.
    fn punt(&self, link: &LinkEntry);
}
