//! Common ticks for periodic work. A program that does all of it at the same time wakes once, and
//! its processor sleeps longer.

use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// Returns the next common tick of this period after `now`, at most one period away. All ticks of
/// this process count from the first call. `period` is not zero.
pub fn next_tick(period: Duration, now: Instant) -> Instant {
    static FIRST: OnceLock<Instant> = OnceLock::new();
    let first = *FIRST.get_or_init(Instant::now);
    let since = now.saturating_duration_since(first).as_nanos() % period.as_nanos().max(1);
    let left = period.as_nanos().saturating_sub(since);
    now + Duration::from_nanos(left.try_into().unwrap_or(u64::MAX))
}

/// An interval whose first tick is at once, and whose further ones are common ticks. It skips the
/// ticks that it is late for.
#[cfg(feature = "watch")]
#[derive(Debug)]
pub struct Ticks(tokio::time::Interval);

#[cfg(feature = "watch")]
impl Ticks {
    pub fn new(period: Duration) -> Self {
        Self(tokio::time::interval(period))
    }

    /// Waits for the next tick. Safe to cancel.
    pub async fn tick(&mut self) {
        self.0.tick().await;
        self.0.reset_at(next_tick(self.0.period(), Instant::now()).into());
    }
}

#[cfg(test)]
#[path = "../tests/unit/ticks.rs"]
mod tests;
