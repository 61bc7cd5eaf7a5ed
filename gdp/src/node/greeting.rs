//! Decides when a reader asks a writer for its current session: at first, and when frames arrive
//! of a session that the writer has not confirmed. Such frames may be of a new session, or
//! recorded. No I/O.

use gdp_core::crypto;
use gdp_core::crypto::CryptoError;

const MS: u64 = 1_000_000;

/// A Hello that is not answered is said so many times, this far apart. From then on each waits
/// twice as long as the one before, up to the longest pause: the writer may hear of this reader
/// much later than the reverse, as between domains; or so long if there is reason to ask.
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
    /// The writer is to be asked, with a new challenge if the last was answered.
    pub fn ask(&mut self, now: u64) -> Result<(), CryptoError> {
        if self.challenge.is_none() {
            (self.challenge, self.tries) = (Some(crypto::random()?), 0);
        }
        let pause = if self.tries < TRIES { EAGER } else { PATIENT };
        let at = self.said_at.map_or(now, |said| (said + pause).max(now));
        self.due = Some(self.due.map_or(at, |due| due.min(at)));
        Ok(())
    }

    /// As [`Self::ask`], of a writer that has just come.
    pub fn begin(&mut self, now: u64) -> Result<(), CryptoError> {
        (self.tries, self.due) = (0, None);
        self.ask(now)
    }

    /// The challenge to send now, if it is time.
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

    /// A Welcome with this challenge: how long it took, if it answers the last Hello.
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
