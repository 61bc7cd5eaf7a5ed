//! Counters by reason.

use std::collections::BTreeMap;
use std::marker::PhantomData;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Why something did not cross: an enumeration that [`reasons`] makes.
pub trait Reason: Copy + 'static {
    /// In the order of their numbers.
    const ALL: &'static [Self];

    /// As the statistics show it.
    fn as_str(self) -> &'static str;

    /// Its place in [`Self::ALL`].
    fn at(self) -> usize;
}

/// Makes an enumeration of reasons, each with its name in the statistics.
macro_rules! reasons {
    ($(#[$about:meta])* pub enum $Reasons:ident { $($(#[$doc:meta])* $Reason:ident = $name:literal,)+ }) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $Reasons { $($(#[$doc])* $Reason,)+ }

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
    /// True if these are the first ones for this reason, which deserves a line in the log.
    pub fn add(&self, reason: R, count: u64) -> bool {
        self.counts[reason.at()].fetch_add(count, Relaxed) == 0
    }

    /// All reasons, also those that did not happen.
    pub fn read(&self) -> BTreeMap<&'static str, u64> {
        R::ALL.iter().map(|reason| (reason.as_str(), self.counts[reason.at()].load(Relaxed))).collect()
    }
}

#[cfg(test)]
#[path = "../tests/unit/tally.rs"]
mod tests;
