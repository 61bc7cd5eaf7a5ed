//! A token bucket, stored as the time when the sent bytes are paid for.

/// A token bucket with a rate in bytes per second and a burst.
#[derive(Clone, Copy, Debug)]
pub struct Meter {
    paid_until: u64,
}

impl Meter {
    pub fn new(now: u64) -> Self {
        Self { paid_until: now }
    }

    /// Returns the time of the next send, at most `burst` nanoseconds before earlier bytes are paid
    /// for.
    pub fn ready_at(&self, burst: u64) -> u64 {
        self.paid_until.saturating_sub(burst)
    }

    /// Charges `bytes` sent now, at `rate` bytes a second. Unused earlier credit expires.
    pub fn take(&mut self, now: u64, bytes: u64, rate: u64) {
        self.take_late(now, bytes, rate, 0);
    }

    /// Charges as [`Self::take`] does. Unused credit of the last `late` nanoseconds stays.
    pub fn take_late(&mut self, now: u64, bytes: u64, rate: u64, late: u64) {
        self.paid_until = self.paid_until.max(now.saturating_sub(late)).saturating_add(nanoseconds(bytes, rate));
    }
}

/// The bytes of the last five to ten seconds.
#[derive(Clone, Copy, Debug)]
pub struct Recent {
    since: u64,
    bytes: u64,
    /// Bytes in the previous step.
    before: u64,
}

/// Length of a step of [`Recent`], in nanoseconds.
const STEP: u64 = 5_000_000_000;

impl Recent {
    pub fn new(now: u64) -> Self {
        Self { since: now, bytes: 0, before: 0 }
    }

    pub fn add(&mut self, now: u64, bytes: u64) {
        self.advance(now);
        self.bytes += bytes;
    }

    pub fn get(&mut self, now: u64) -> u64 {
        self.advance(now);
        self.before + self.bytes
    }

    /// Starts the step of this time. Threads read the clock before they lock, so an earlier time
    /// may follow a later one.
    fn advance(&mut self, now: u64) {
        let steps = now.saturating_sub(self.since) / STEP;
        if steps > 0 {
            self.before = if steps == 1 { self.bytes } else { 0 };
            (self.bytes, self.since) = (0, self.since + steps * STEP);
        }
    }
}

/// Returns the time for `bytes` at `rate` bytes a second.
pub fn nanoseconds(bytes: u64, rate: u64) -> u64 {
    (u128::from(bytes) * 1_000_000_000 / u128::from(rate.max(1))).min(u128::from(u64::MAX)) as u64
}

#[cfg(test)]
#[path = "../../tests/unit/transport/meter.rs"]
mod tests;
