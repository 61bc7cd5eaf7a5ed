//! The tables of a data plane, as seen by the forwarding decision.

use crate::table::{FibEntry, LinkEntry, Permit};
use crate::{Header, Name, hop, replay};

/// The lookups of [`crate::forward::decide`] in a data plane. They must be bounded and must not
/// block.
pub trait Tables {
    /// Whether no other plane follows this one.
    const LAST: bool;

    /// Returns `value`. Called where the many paths of a decision meet. Overridden by the plane
    /// whose code is verified path by path, to have the rest verified once. `V` has at most 8
    /// bytes, and no padding.
    #[inline(always)]
    fn joined<V: Copy>(&self, value: V) -> V {
        value
    }

    /// The next hop of a frame, as far as its link does not determine it.
    type NextHop: Copy + Default;

    /// Returns the link with this id, if it is live.
    fn link(&self, id: u32) -> Option<&LinkEntry>;

    /// Returns the route of a name.
    fn route(&self, name: &Name) -> Option<FibEntry>;

    /// Returns the link id of the neighbour on the path to egress switch `bit` (0 … 63); 0 if
    /// there is none.
    fn next_hop(&self, bit: u32) -> u32;

    /// Returns this switch's own egress bit.
    fn own_bit(&self) -> u64;

    /// Returns whether this [`Permit`] exists.
    fn is_permitted(&self, permit: &Permit) -> bool;

    /// Returns the replay window of a link, shared by all planes that receive its frames.
    fn window(&self, link: &LinkEntry) -> Option<impl replay::Words>;

    /// Returns the count of the next frame that leaves by this link, starting with 1.
    fn next_count(&self, link: &LinkEntry) -> u64;

    /// Returns whether the hop tag of a frame is right for its header and its whole `count` on the
    /// link under `key`. Overridden by planes that check many tags at once.
    #[inline(always)]
    fn has_tag(&self, header: &Header, key: [u64; 2], count: u64) -> bool {
        header.tag_for(key, count) == header.tag()
    }

    /// Writes the fields of `link` into the header of the next frame that leaves by it, or
    /// schedules this before the frame leaves. Overridden by planes that compute many tags at once.
    #[inline(always)]
    fn stamp(&self, header: &mut Header, link: &LinkEntry) {
        hop::stamp(header, link, self.next_count(link));
    }

    /// Returns whether this plane can send on the link now, and writes the next hop to `hop`.
    /// Called only on a plane that is not the last.
    fn resolve(&self, link: &LinkEntry, hop: &mut Self::NextHop) -> bool;

    /// Returns whether this plane can copy a frame of `length` bytes to the links of a group that
    /// lead to `bits`. Called only on a plane that is not the last.
    fn can_copy(&self, group: u32, bits: u64, length: usize) -> bool;

    /// Returns whether this plane has a long queue for the link. Frames that support marks are then
    /// marked.
    fn has_queue(&self, link: &LinkEntry) -> bool;

    /// Returns whether an error may go to the neighbour on this link now. The minimum interval is
    /// [`COMPLAINT_INTERVAL_NS`](crate::table::COMPLAINT_INTERVAL_NS).
    fn may_send_error(&self, link: &LinkEntry) -> bool;

    /// Records that an error goes to the neighbour on this link now.
    fn send_error(&self, link: &LinkEntry);

    /// Returns whether the daemon may receive a probe from the neighbour on this link now. The
    /// minimum interval is [`PUNT_INTERVAL_NS`](crate::table::PUNT_INTERVAL_NS).
    fn may_punt(&self, link: &LinkEntry) -> bool;

    /// Records that the daemon receives a probe from this link now.
    fn punt(&self, link: &LinkEntry);
}
