//! The drop reasons of a reader. One enum, with the labels for metrics and logs.

use std::fmt;

macro_rules! reasons {
    ($($(#[doc = $doc:literal])* $variant:ident = $label:literal,)*) => {
        /// The reason that a segment or a whole message was not delivered.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        #[repr(u8)]
        pub enum DropReason { $($(#[doc = $doc])* $variant,)* }

        impl DropReason {
            /// All reasons in numerical order.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)*];

            /// Returns the label of the metric. The prefix `seal_` distinguishes it from the drop
            /// reasons of frames.
            pub const fn label(self) -> &'static str {
                match self { $(Self::$variant => concat!("seal_", $label),)* }
            }

            /// Returns the reason in a sentence, as its documentation states it.
            pub const fn about(self) -> &'static str {
                match self { $(Self::$variant => concat!($($doc),*),)* }
            }
        }
    };
}

reasons! {
    /// The payload ends within a segment.
    Truncated = "truncated",
    /// Inconsistent header fields.
    BadHeader = "bad_header",
    /// Another version of segments. The release of the writer or of this reader is too old.
    OtherVersion = "other_version",
    /// An unknown kind of segments or a critical extension that is unknown. The release of this
    /// reader is too old.
    Unsupported = "unsupported",
    /// The message would be larger than the limit.
    TooLarge = "too_large",
    /// The writer of this name is not or no longer authorised.
    UnknownWriter = "unknown_writer",
    /// Sealed in an epoch of the writer whose key the reader does not have yet or any more.
    NoKey = "no_key",
    /// Did not open under the session's key: modified, forged, or sealed for another name, writer,
    /// session or epoch.
    Forged = "forged",
    /// The writer has not confirmed the session to this reader, so the segment may be a recording.
    Unvouched = "unvouched",
    /// Older than the replay window, or signed longer ago than the reader accepts.
    TooOld = "too_old",
    /// The segment was already received, or its message was delivered.
    Duplicate = "duplicate",
    /// The segment differs in shape from other segments of its message.
    Inconsistent = "inconsistent",
    /// The memory limits are exhausted.
    MemoryFull = "memory_full",
    /// An incomplete message was evicted in favour of newer ones.
    Evicted = "evicted",
    /// A message was incomplete at its deadline.
    Deadline = "deadline",
    /// The proof or the message header is malformed.
    BadMessage = "bad_message",
    /// The writer did not sign this message.
    BadSignature = "bad_signature",
    /// The signature has a high `s`, the form that anybody can make of a good signature.
    HighS = "high_s",
    /// The sequence is before the first one that the writer has confirmed for its session.
    Stale = "stale",
    /// The cryptographic library failed.
    Internal = "internal",
}

impl DropReason {
    /// Number of reasons.
    pub const COUNT: usize = Self::ALL.len();
}

impl std::error::Error for DropReason {}

impl fmt::Display for DropReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.label())
    }
}
