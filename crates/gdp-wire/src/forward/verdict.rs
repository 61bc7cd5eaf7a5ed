//! What a data plane must do with a frame.

use crate::{Counter, LinkEntry};

/// What a data plane must do with a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict<'t, H> {
    /// Send it by this link to this next hop; the header has been rewritten for it, but for what
    /// [`Tables::stamp`] has left for later.
    Send(&'t LinkEntry, H, Counter),
    /// For each link of this group that [`copy()`] says so, send what that makes of it; count it as
    /// [`Counter::Replicated`].
    Copies(u32),
    /// The header has become an answer to the neighbour: send it by this link to this next hop,
    /// without a payload.
    Answer(&'t LinkEntry, H, Counter),
    /// It is for this node itself, unchanged: an error, the answer to an echo, or a probe that ends
    /// here; counted as [`Counter::Notice`].
    Notice(&'t LinkEntry),
    /// Leave it, untouched, to the next plane; counted as [`Counter::Slow`].
    Slow,
    /// Drop it and count why.
    Drop(Counter),
}

/// What the first bytes of a frame say it is, before its header is read whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Has a [`Header`]: for [`decide`], or [`accept`].
    Headed,
    Control,
    Unknown,
}
