//! A token bucket, kept as the time until which what went is paid for.

/// So many bytes a second, with a burst.
#[derive(Clone, Copy, Debug)]
pub struct Meter {
    paid_until: u64,
}

impl Meter {
    pub fn new(now: u64) -> Self {
        Self { paid_until: now }
    }

    /// When bytes may go again, if they may go up to `burst` nanoseconds before they are paid for.
    pub fn ready_at(&self, burst: u64) -> u64 {
        self.paid_until.saturating_sub(burst)
    }

    /// `bytes` go now, at `rate` bytes a second. What was not used before is lost.
    pub fn take(&mut self, now: u64, bytes: u64, rate: u64) {
        self.paid_until = self.paid_until.max(now).saturating_add(nanoseconds(bytes, rate));
    }
}

/// How long `bytes` take at `rate` bytes a second.
pub fn nanoseconds(bytes: u64, rate: u64) -> u64 {
    (u128::from(bytes) * 1_000_000_000 / u128::from(rate.max(1))).min(u128::from(u64::MAX)) as u64
}
