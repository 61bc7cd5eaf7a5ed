//! Measures how long a stage of a message's path takes: percentiles of the latest messages, for the
//! statistics.

use std::time::Duration;

use gdp_util::unix_time::unix_nanos;

use parking_lot::Mutex;
use serde::Serialize;

/// The number of latest messages that the percentiles cover.
const LATEST: usize = 1024;

/// The latest durations of one stage. It locks once for each message.
#[derive(Default)]
pub struct Timing(Mutex<Ring>);

#[derive(Default)]
struct Ring {
    /// Durations in microseconds.
    latest: Vec<u32>,
    next: usize,
}

/// Percentiles in microseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Percentiles {
    pub p50: u32,
    pub p99: u32,
}

impl Timing {
    pub fn record(&self, took: Duration) {
        let micros = u32::try_from(took.as_micros()).unwrap_or(u32::MAX);
        let mut ring = self.0.lock();
        let at = ring.next;
        match ring.latest.get_mut(at) {
            Some(oldest) => *oldest = micros,
            None => ring.latest.push(micros),
        }
        ring.next = (at + 1) % LATEST;
    }

    /// Records the time since `unix_ns` on another machine's clock. It is as accurate as the two
    /// clocks agree.
    pub fn record_since(&self, unix_ns: u64) {
        self.record(Duration::from_nanos(unix_nanos().saturating_sub(unix_ns)));
    }

    /// Returns `None` before the first message.
    pub fn percentiles(&self) -> Option<Percentiles> {
        let mut sorted = self.0.lock().latest.clone();
        sorted.sort_unstable();
        let at =
            |percent: usize| sorted.get((sorted.len() * percent / 100).min(sorted.len().saturating_sub(1))).copied();
        Some(Percentiles { p50: at(50)?, p99: at(99)? })
    }
}

#[cfg(test)]
#[path = "../tests/unit/timing.rs"]
mod tests;
