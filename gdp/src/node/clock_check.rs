//! Decides when a reader asks a writer for its time, and computes how far the two clocks differ.
//!
//! The reader asks when something that the writer signed is too old. That may have been late, and
//! only an answer to a fresh challenge tells whether the clocks differ. No I/O.

use gdp_core::crypto::{self, CryptoError};

const MS: u64 = 1_000_000;

/// Repetitions of an unanswered question, in nanoseconds, and their maximum number. A writer of an
/// earlier release does not answer.
const RETRY: u64 = 500 * MS;
const TRIES: u32 = 5;

/// Minimum time between two questions otherwise, in nanoseconds.
const AGAIN: u64 = 20_000 * MS;

#[derive(Debug, Default)]
pub struct ClockCheck {
    /// The open question.
    challenge: Option<[u8; 16]>,
    tries: u32,
    asked_at: Option<u64>,
    due: Option<u64>,
}

impl ClockCheck {
    /// Schedules a question, because something was too old.
    pub fn too_old(&mut self, now: u64) -> Result<(), CryptoError> {
        if self.due.is_some() {
            return Ok(());
        }
        let at = self.asked_at.map_or(now, |asked| (asked + AGAIN).max(now));
        (self.challenge, self.tries, self.due) = (Some(crypto::random()?), 0, Some(at));
        Ok(())
    }

    /// Returns the challenge to send now, if a question is due.
    pub fn poll(&mut self, now: u64) -> Option<[u8; 16]> {
        self.due.take_if(|due| *due <= now)?;
        self.tries += 1;
        self.asked_at = Some(now);
        self.due = (self.tries < TRIES).then_some(now + RETRY);
        self.challenge
    }

    pub fn next_wake(&self) -> Option<u64> {
        self.due
    }

    /// Processes an answer: the writer's Unix time, with this node's at present, in nanoseconds.
    /// Returns the nanoseconds by which the writer's clock is ahead of this one, if the answer is
    /// to the open question.
    pub fn answered(&mut self, now: u64, challenge: &[u8; 16], own: u64, theirs: u64) -> Option<i64> {
        self.challenge.take_if(|sent| sent == challenge)?;
        self.due = None;
        let under_way = now.saturating_sub(self.asked_at.unwrap_or(now)) / 2;
        Some(ahead(theirs.saturating_add(under_way), own))
    }
}

/// Returns by how much one time is ahead of another.
pub fn ahead(of: u64, other: u64) -> i64 {
    i64::try_from(i128::from(of) - i128::from(other)).unwrap_or(if of > other { i64::MAX } else { i64::MIN })
}

#[cfg(test)]
#[path = "../../tests/unit/node/clock_check.rs"]
mod tests;
