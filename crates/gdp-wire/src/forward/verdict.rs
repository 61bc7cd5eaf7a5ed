//! The verdict for a frame, which a data plane carries out.

use crate::{Counter, LinkEntry};

/// The verdict for a frame, which a data plane carries out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict<'t, H> {
    /// Send the frame by this link to this next hop. The header is rewritten, except for the
    /// deferred part of [`Tables::stamp`](crate::tables::Tables::stamp).
    Send(&'t LinkEntry, H, Counter),
    /// Call [`copy()`](super::copy()) for each link of this group, and send the copies. Count the
    /// frame as [`Counter::Replicated`].
    Copies(u32),
    /// The header has become an answer to the neighbour. Send it by this link to this next hop,
    /// without a payload.
    Answer(&'t LinkEntry, H, Counter),
    /// The unchanged frame is for this node: an error, the answer to an echo, or a probe that ends
    /// here. Counted as [`Counter::Notice`].
    Notice(&'t LinkEntry),
    /// Leave the unchanged frame to the next plane. Counted as [`Counter::Slow`].
    Slow,
    /// Drop the frame and count the reason.
    Drop(Counter),
}

/// The kind of a frame by its first byte, before its header is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Has a [`Header`](crate::Header): for [`decide`](super::decide) or [`accept`](super::accept).
    Headed,
    Control,
    Unknown,
}
