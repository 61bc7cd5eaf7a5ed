//! The counters of a data plane. Every frame and every copy is counted in exactly one of them. A
//! frame that is lost afterwards is counted a second time, see [`Counter::RedirectLost`]. All
//! planes share one enum, one per-CPU array and one metric family.

/// Sampling ratio of names: one in this many frames that leave is counted for its name.
pub const SAMPLING: u64 = 64;

/// Maximum number of names that each plane counts frames for. When full, the kernel evicts the
/// least recently seen name, and the userspace plane the least counted one.
pub const BUSIEST_NAMES: u32 = 1024;

/// Returns whether a frame that arrived with this hop tag is counted for its name. Tags are as good
/// as random. The tag 0 does not count; the benchmark's switch without tags has only 0.
#[inline(always)]
pub const fn is_sampled(tag: u64) -> bool {
    tag % SAMPLING == 1
}

macro_rules! counters {
    ($($(#[doc = $doc:literal])* $variant:ident = $text:literal,)*) => {
        /// The outcome for a frame.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[repr(u32)]
        pub enum Counter { $($(#[doc = $doc])* $variant,)* }

        impl Counter {
            /// All counters, in index order.
            pub const ALL: &'static [Counter] = &[$(Counter::$variant,)*];

            /// Returns the name of the counter in command output, metrics and fixtures.
            pub const fn as_str(self) -> &'static str {
                match self { $(Counter::$variant => $text,)* }
            }

            /// Returns what the counter counts, as its documentation states it.
            pub const fn about(self) -> &'static str {
                match self { $(Counter::$variant => concat!($($doc),*),)* }
            }
        }
    };
}

counters! {
    /// Sent on towards another switch.
    Forwarded = "forwarded",
    /// Sent to the link of a local endpoint.
    Delivered = "delivered",
    /// Copied to the links of a group. Each copy is also counted as forwarded, delivered or
    /// dropped.
    Replicated = "replicated",
    /// An echo that was answered.
    Echoed = "echoed",
    /// For this node itself: an error, the answer to an echo, or a probe that ends here.
    Notice = "notice",
    /// Left to the userspace plane, because the kernel cannot send on the next link or the frame is
    /// for the daemon.
    Slow = "slow",
    /// A control frame, for the daemon.
    Control = "control",
    /// Not a GDP frame for this switch. Passed to the host unchanged.
    Foreign = "foreign",
    /// Dropped: shorter than a header, or than the length in the header.
    Truncated = "drop_truncated",
    /// Dropped: a version other than 2, a type unknown to this switch, or a header of another
    /// length.
    Unknown = "drop_unknown",
    /// Dropped: no link has the id in the header.
    NoLink = "drop_no_link",
    /// Dropped: the hop tag was not made with the link's key.
    BadTag = "drop_bad_tag",
    /// Dropped: a frame with this link counter was already accepted, or the counter is older than
    /// the replay window.
    Replayed = "drop_replayed",
    /// Dropped: the hop limit is used up.
    HopLimit = "drop_hop_limit",
    /// Dropped: the link may not send as this source.
    Source = "drop_source",
    /// Dropped: the name is not in the FIB, or the FIB has no link for it here.
    NoRoute = "drop_no_route",
    /// Dropped: the link may not send to this name.
    NotPermitted = "drop_not_permitted",
    /// Dropped: no live neighbour leads to the egress switch, or the frame has no egress bit. Also
    /// a probe with several egress bits.
    NoEgress = "drop_no_egress",
    /// Dropped: the frame would leave by the link that it arrived on.
    Hairpin = "drop_hairpin",
    /// Dropped: the frame came from another domain and would leave for a third.
    SplitHorizon = "drop_split_horizon",
    /// Dropped: larger than the next link's MTU.
    TooBig = "drop_too_big",
    /// Dropped: a router marked the outer packet (congestion experienced), and the writer of the
    /// frame does not support marks.
    Congested = "drop_congested",
    /// Dropped: a probe that ends here, too soon after the previous one on its link.
    PuntLimit = "drop_punt_limit",
    /// Dropped: the kernel refused the redirect.
    RedirectFailed = "drop_redirect_failed",
    /// Dropped after the decision: the egress interface did not take the redirected frame. The
    /// frame is already counted as [`Counter::Forwarded`], [`Counter::Delivered`] or
    /// [`Counter::Echoed`], or, for an error, as the drop that the error reports.
    RedirectLost = "drop_redirect_lost",
}

impl Counter {
    /// Number of counters.
    pub const COUNT: usize = Counter::ALL.len();

    /// Returns whether frames counted here were dropped before their link was known.
    pub const fn is_before_link(self) -> bool {
        matches!(self, Counter::Truncated | Counter::Unknown | Counter::NoLink)
    }

    /// Returns whether frames counted here were sent on, in one or several copies.
    pub const fn is_onward(self) -> bool {
        matches!(self, Counter::Forwarded | Counter::Delivered | Counter::Replicated)
    }

    /// Returns whether frames counted here are lost.
    pub const fn is_drop(self) -> bool {
        self as u32 >= Counter::Truncated as u32
    }
}

#[cfg(test)]
#[path = "../tests/unit/counter.rs"]
mod tests;
