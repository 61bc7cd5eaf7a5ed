//! The times that this node signs into messages: those of this machine's clock, which do not go
//! back when the clock is set back. Readers refuse what seems old, so a publisher whose clock goes
//! back would lose every message. Only this node's own clocks count here, and nothing that a peer
//! states.

use std::sync::atomic::{AtomicI64, Ordering};

/// A clock that goes back by less is followed, in nanoseconds: readers accept messages of that age.
const SMALL: i64 = 1_000_000_000;

/// A clock that goes back by more was wrong before, in nanoseconds.
const LARGE: i64 = 24 * 3600 * 1_000_000_000;

/// Nanoseconds from the steady clock's zero to the Unix epoch, as of the last time; `i64::MIN`
/// before the first.
#[derive(Debug)]
pub struct Stamps(AtomicI64);

impl Default for Stamps {
    fn default() -> Self {
        Self(AtomicI64::new(i64::MIN))
    }
}

impl Stamps {
    /// Returns the time to sign. `steady` and `unix` are the nanoseconds of the two clocks.
    pub fn next(&self, steady: u64, unix: u64) -> u64 {
        let offset = (unix as i64).wrapping_sub(steady as i64);
        let before = self.0.load(Ordering::Relaxed);
        let back = before.saturating_sub(offset);
        if before != i64::MIN && (SMALL..LARGE).contains(&back) {
            return (steady as i64).wrapping_add(before) as u64;
        }
        self.0.store(offset, Ordering::Relaxed);
        unix
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/stamps.rs"]
mod tests;
