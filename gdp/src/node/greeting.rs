//! Decides when a reader requests a writer's current session with a Hello.
//!
//! The reader asks at first, and when frames arrive of a session that the writer has not confirmed.
//! Such frames may belong to a new session, or may be replayed. No I/O.

use gdp_core::crypto;
use gdp_core::crypto::CryptoError;

const MS: u64 = 1_000_000;

/// Retransmission of an unanswered Hello: this many times at the eager interval. The interval then
/// doubles up to the longest one, because the writer may learn of this reader much later than the
/// reverse, as between domains. With a reason to ask, the reader repeats at the patient interval
/// instead.
const TRIES: u32 = 5;
const EAGER: u64 = 100 * MS;
const LONGEST: u64 = 30_000 * MS;
const PATIENT: u64 = 2_000 * MS;

#[derive(Debug, Default)]
pub struct Greeting {
    challenge: Option<[u8; 16]>,
    tries: u32,
    said_at: Option<u64>,
    due: Option<u64>,
}

impl Greeting {
    /// Schedules a Hello, with a new challenge if the last one was answered.
    pub fn ask(&mut self, now: u64) -> Result<(), CryptoError> {
        if self.challenge.is_none() {
            (self.challenge, self.tries) = (Some(crypto::random()?), 0);
        }
        let pause = if self.tries < TRIES { EAGER } else { PATIENT };
        let at = self.said_at.map_or(now, |said| (said + pause).max(now));
        self.due = Some(self.due.map_or(at, |due| due.min(at)));
        Ok(())
    }

    /// Schedules a Hello as [`Self::ask`] does, to a writer that has just joined.
    pub fn begin(&mut self, now: u64) -> Result<(), CryptoError> {
        (self.tries, self.due) = (0, None);
        self.ask(now)
    }

    /// Returns the challenge to send now, if a Hello is due.
    pub fn poll(&mut self, now: u64) -> Option<[u8; 16]> {
        self.due.take_if(|due| *due <= now)?;
        self.said_at = Some(now);
        let pause = EAGER << self.tries.saturating_sub(TRIES - 1).min(10);
        self.due = Some(now + pause.min(LONGEST));
        self.tries = self.tries.saturating_add(1);
        self.challenge
    }

    pub fn next_wake(&self) -> Option<u64> {
        self.due
    }

    /// Processes a Welcome with this challenge. Returns the round-trip time if it answers the last
    /// Hello.
    pub fn answered(&mut self, now: u64, challenge: &[u8; 16]) -> Option<u64> {
        self.challenge.take_if(|said| said == challenge)?;
        self.due = None;
        self.tries = 0;
        Some(now - self.said_at.unwrap_or(now))
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/greeting.rs"]
mod tests;
