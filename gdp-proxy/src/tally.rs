//! Counters by reason.

use std::collections::BTreeMap;
use std::marker::PhantomData;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// A reason why something was not carried: an enumeration that [`reasons`] makes.
pub trait Reason: Copy + 'static {
    /// All reasons, in the order of their numbers.
    const ALL: &'static [Self];

    /// The reason's key in the statistics.
    fn as_str(self) -> &'static str;

    /// The reason's index in [`Self::ALL`].
    fn at(self) -> usize;
}

/// Defines an enumeration of reasons, each with its name in the statistics.
macro_rules! reasons {
    ($(#[$about:meta])* pub enum $Reasons:ident { $($(#[doc = $doc:literal])* $Reason:ident = $name:literal,)+ }) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $Reasons { $($(#[doc = $doc])* $Reason,)+ }

        impl $Reasons {
            /// Returns the reason in a sentence, as its documentation states it.
            pub const fn about(self) -> &'static str {
                match self { $(Self::$Reason => concat!($($doc),+)),+ }
            }
        }

        impl $crate::tally::Reason for $Reasons {
            const ALL: &'static [Self] = &[$(Self::$Reason),+];

            fn as_str(self) -> &'static str {
                match self { $(Self::$Reason => $name),+ }
            }

            fn at(self) -> usize {
                self as usize
            }
        }
    };
}

pub(crate) use reasons;

/// One counter for each reason. Counting neither allocates nor locks.
pub struct Tally<R> {
    counts: Box<[AtomicU64]>,
    of: PhantomData<fn(R)>,
}

impl<R: Reason> Default for Tally<R> {
    fn default() -> Self {
        Self { counts: R::ALL.iter().map(|_| AtomicU64::new(0)).collect(), of: PhantomData }
    }
}

impl<R: Reason> Tally<R> {
    /// Adds `count` to the counter. Returns true if it was zero, so that the first occurrence is
    /// logged.
    pub fn add(&self, reason: R, count: u64) -> bool {
        self.counts[reason.at()].fetch_add(count, Relaxed) == 0
    }

    /// Returns the counters of all reasons, with zero for those that did not occur.
    pub fn read(&self) -> BTreeMap<&'static str, u64> {
        R::ALL.iter().map(|reason| (reason.as_str(), self.counts[reason.at()].load(Relaxed))).collect()
    }
}

#[cfg(test)]
#[path = "../tests/unit/tally.rs"]
mod tests;
