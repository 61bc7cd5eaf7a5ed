//! Why a reader did not deliver something. One enum, with the labels that metrics and logs use.

use std::fmt;

macro_rules! reasons {
    ($($(#[$doc:meta])* $variant:ident = $label:literal,)*) => {
        /// Why a segment, or a whole message, was not delivered.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        #[repr(u8)]
        pub enum DropReason { $($(#[$doc])* $variant,)* }

        impl DropReason {
            /// All reasons, in the order of their numbers.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)*];

            /// The label of the metric, which tells it from those of frames by its `seal_`.
            pub const fn label(self) -> &'static str {
                match self { $(Self::$variant => concat!("seal_", $label),)* }
            }
        }
    };
}

reasons! {
    /// The payload ends within a segment.
    Truncated = "truncated",
    /// Another version, or header fields that do not fit each other.
    BadHeader = "bad_header",
    /// The message would be larger than the limit.
    TooLarge = "too_large",
    /// No writer of this name, or not any more.
    UnknownWriter = "unknown_writer",
    /// Sealed in an epoch of the writer whose key is not here, not yet or not any more.
    NoKey = "no_key",
    /// Did not open under the session's key: changed, made up, or sealed for another name, writer,
    /// session or epoch.
    Forged = "forged",
    /// Of a session that the writer has not vouched for to this reader: it may be a recording.
    Unvouched = "unvouched",
    /// So far behind that nobody remembers whether it was delivered, or signed longer ago than the
    /// reader accepts.
    TooOld = "too_old",
    /// This segment is here already, or its message was delivered.
    Duplicate = "duplicate",
    /// Differs in shape from other segments of its message.
    Inconsistent = "inconsistent",
    /// No memory left within the limits.
    MemoryFull = "memory_full",
    /// An incomplete message gave way to newer ones.
    Evicted = "evicted",
    /// A message was not complete at its deadline.
    Deadline = "deadline",
    /// The proof or the message header makes no sense.
    BadMessage = "bad_message",
    /// The writer did not sign this message.
    BadSignature = "bad_signature",
    /// From before the sequence that the writer has vouched for its session from.
    Stale = "stale",
    /// The cryptographic library failed.
    Internal = "internal",
}

impl DropReason {
    /// How many reasons there are.
    pub const COUNT: usize = Self::ALL.len();
}

impl std::error::Error for DropReason {}

impl fmt::Display for DropReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.label())
    }
}
