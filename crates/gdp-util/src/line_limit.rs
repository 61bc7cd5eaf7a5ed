//! A limit on log lines of one kind, so that one cause with many victims does not flood the log.

use std::time::{Duration, Instant};

use parking_lot::Mutex;

/// Lets the first lines of each period pass, and counts the others.
#[derive(Debug)]
pub struct LineLimit {
    lines: u32,
    period: Duration,
    current: Mutex<Period>,
}

#[derive(Clone, Copy, Debug)]
struct Period {
    begun: Option<Instant>,
    passed: u32,
    suppressed: u64,
}

impl LineLimit {
    /// Lets `lines` lines pass in each `period`.
    pub const fn new(lines: u32, period: Duration) -> Self {
        Self { lines, period, current: Mutex::new(Period { begun: None, passed: 0, suppressed: 0 }) }
    }

    /// Asks for one line. Returns the number of lines that were suppressed since the last one, or
    /// `None` if this line is suppressed as well.
    pub fn take(&self, now: Instant) -> Option<u64> {
        let mut current = self.current.lock();
        if current.begun.is_none_or(|begun| now.saturating_duration_since(begun) >= self.period) {
            (current.begun, current.passed) = (Some(now), 0);
        }
        if current.passed >= self.lines {
            current.suppressed += 1;
            return None;
        }
        current.passed += 1;
        Some(std::mem::take(&mut current.suppressed))
    }
}

/// Whether two messages differ in digits at most, such as times. The second one is then no news.
pub fn differ_in_digits_at_most(one: &str, other: &str) -> bool {
    let text =
        |text: &str| text.split(|c: char| c.is_ascii_digit()).filter(|part| !part.is_empty()).collect::<String>();
    text(one) == text(other)
}

#[cfg(test)]
#[path = "../tests/unit/line_limit.rs"]
mod tests;
