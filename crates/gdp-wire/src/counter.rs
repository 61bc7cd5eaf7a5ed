//! The counters of a data plane: every frame and every copy ends in exactly one of them. A frame
//! that is lost after that is counted once more, see [`Counter::RedirectLost`]. One enum, one
//! per-CPU array, one metric family, the same for all planes.

/// Of how many frames that leave one is counted for its name.
pub const SAMPLING: u64 = 64;

/// Names that each plane counts frames for; a switch forgets those it saw least.
pub const BUSIEST_NAMES: u32 = 1024;

/// Whether a frame that arrived with this hop tag is counted for its name. A tag is as good as
/// random; 0, which is what every tag is in the bench's switch without tags, does not count.
#[inline(always)]
pub const fn is_sampled(tag: u64) -> bool {
    tag % SAMPLING == 1
}

macro_rules! counters {
    ($($(#[$doc:meta])* $variant:ident = $text:literal,)*) => {
        /// What became of a frame.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[repr(u32)]
        pub enum Counter { $($(#[$doc])* $variant,)* }

        impl Counter {
            /// All counters, in the order of their indices.
            pub const ALL: &'static [Counter] = &[$(Counter::$variant,)*];

            /// The name of the counter in command output, metrics and fixtures.
            pub const fn as_str(self) -> &'static str {
                match self { $(Counter::$variant => $text,)* }
            }
        }
    };
}

counters! {
    /// Sent on toward another switch.
    Forwarded = "forwarded",
    /// Sent to the link of a local endpoint.
    Delivered = "delivered",
    /// Copied to the links of a group. Each copy is counted as well, as forwarded, delivered or
    /// dropped.
    Replicated = "replicated",
    /// An echo, answered.
    Echoed = "echoed",
    /// An error, the answer to an echo or a probe, for this node itself.
    Notice = "notice",
    /// Left to the userspace plane, because the kernel cannot send by the next link, or the frame
    /// is for the daemon.
    Slow = "slow",
    /// A control frame, for the daemon.
    Control = "control",
    /// Not for us: not GDP. Passed on to the host untouched.
    Foreign = "foreign",
    /// Dropped: shorter than its header, or than the header says it is.
    Truncated = "drop_truncated",
    /// Dropped: a version other than 1, a type this switch does not know, or a header of another
    /// length.
    Unknown = "drop_unknown",
    /// Dropped: no link has the id in the header.
    NoLink = "drop_no_link",
    /// Dropped: the hop tag was not made with the link's key.
    BadTag = "drop_bad_tag",
    /// Dropped: a frame with this link counter was taken before, or the counter is too old to say.
    Replayed = "drop_replayed",
    /// Dropped: the hop limit is used up.
    HopLimit = "drop_hop_limit",
    /// Dropped: the link may not send as this source.
    Source = "drop_source",
    /// Dropped: the name is not in the FIB, or the FIB has no link for it here.
    NoRoute = "drop_no_route",
    /// Dropped: the link may not send to this name.
    NotPermitted = "drop_not_permitted",
    /// Dropped: no live neighbour leads to the egress switch, or the frame names none; or it is a
    /// probe and names several.
    NoEgress = "drop_no_egress",
    /// Dropped: would leave by the link it came in on.
    Hairpin = "drop_hairpin",
    /// Dropped: came from another domain and would leave for a third.
    SplitHorizon = "drop_split_horizon",
    /// Dropped: larger than the next link's MTU.
    TooBig = "drop_too_big",
    /// Dropped: a router marked what carried the frame (congestion experienced), and its writer
    /// does not take marks.
    Congested = "drop_congested",
    /// Dropped: a probe that ends here, too soon after the one before on its link.
    PuntLimit = "drop_punt_limit",
    /// Dropped: the decision was to redirect, and the kernel refused.
    RedirectFailed = "drop_redirect_failed",
    /// Dropped after the decision: the interface it was redirected to did not take it. It is
    /// counted already, as [`Counter::Forwarded`], [`Counter::Delivered`] or [`Counter::Echoed`],
    /// or, if it is an error, as the drop that it answers.
    RedirectLost = "drop_redirect_lost",
}

impl Counter {
    /// How many counters there are.
    pub const COUNT: usize = Counter::ALL.len();

    /// Whether frames counted here were dropped before it was known that they are on a link.
    pub const fn is_before_link(self) -> bool {
        matches!(self, Counter::Truncated | Counter::Unknown | Counter::NoLink)
    }

    /// Whether frames counted here were sent on, in one copy or several.
    pub const fn is_onward(self) -> bool {
        matches!(self, Counter::Forwarded | Counter::Delivered | Counter::Replicated)
    }

    /// Whether frames counted here are lost.
    pub const fn is_drop(self) -> bool {
        self as u32 >= Counter::Truncated as u32
    }
}

#[cfg(test)]
#[path = "../tests/unit/counter.rs"]
mod tests;
