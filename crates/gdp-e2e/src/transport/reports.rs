//! When a reader reports what it has received, and what it reports.

use gdp_wire::Name;

use super::{MS, Position};
use crate::feedback_wire::Feedback;

/// Interval between reports of few bytes while nothing is missing, and the delay of the first one.
/// Other reports to the same entity may travel along meanwhile.
const SLOWEST_REPORT: u64 = 100 * MS;
const REPORT_DELAY: u64 = 20 * MS;

/// Number of bytes that cause an earlier report: half a round trip after the last one, but at least
/// [`FASTEST_REPORT`].
pub(super) const SOME_BYTES: u64 = 16 << 10;
const FASTEST_REPORT: u64 = 10 * MS;

/// Number of bytes that cause a still earlier report on short paths.
const MANY_BYTES: u64 = 64 << 10;
const FASTEST_OF_MANY: u64 = 2 * MS;

/// The counts of a session's segments, and the time of the next report about them.
#[derive(Debug)]
pub struct Reports {
    at: u64,
    last_at: Option<u64>,
    /// The first sequence that was not settled at the last report.
    last_next: u64,
    /// The writer has asked for a report, or lacks the last one.
    is_urgent: bool,
    segments: u64,
    bytes: u64,
    last_bytes: u64,
    needless_bytes: u64,
    ce: u32,
    /// The last new segment since the last report, and its arrival time.
    echo: Option<(Position, u64)>,
}

impl Reports {
    /// Starts a session whose first sequence is `from`.
    pub fn new(from: u64) -> Self {
        Self {
            at: u64::MAX,
            last_at: None,
            last_next: from,
            is_urgent: false,
            segments: 0,
            bytes: 0,
            last_bytes: 0,
            needless_bytes: 0,
            ce: 0,
            echo: None,
        }
    }

    /// Counts a frame with a congestion mark.
    pub fn on_mark(&mut self) {
        self.ce = self.ce.wrapping_add(1);
    }

    /// Counts a new segment.
    pub fn on_segment(&mut self, now: u64, position: Position, bytes: usize) {
        self.segments += 1;
        self.bytes += bytes as u64;
        self.echo = Some((position, now));
    }

    /// Counts a segment whose request was needless.
    pub fn on_needless(&mut self, bytes: usize) {
        self.needless_bytes += bytes as u64;
    }

    /// Returns the time of the next report; `u64::MAX` if there is nothing to report.
    pub fn due_at(&self) -> u64 {
        self.at
    }

    /// Makes the next report urgent.
    pub fn expedite(&mut self) {
        self.is_urgent = true;
    }

    /// Schedules the next report. `next` is the first sequence that is not settled. `history` is
    /// the number of settled messages after which the writer needs a report.
    pub fn plan(&mut self, now: u64, rtt: u64, next: u64, history: u64) {
        let bytes = self.bytes - self.last_bytes;
        let is_history_filling = next.saturating_sub(self.last_next) >= history;
        let (interval, delay) = if bytes >= MANY_BYTES || is_history_filling {
            ((rtt / 2).clamp(FASTEST_OF_MANY, SLOWEST_REPORT), 0)
        } else if bytes >= SOME_BYTES || self.is_urgent {
            (report_interval(rtt), 0)
        } else {
            (SLOWEST_REPORT, REPORT_DELAY)
        };
        let at = self.last_at.map_or(now, |last| (last + interval).max(now + delay));
        self.at = self.at.min(at);
    }

    /// Returns the report.
    pub fn report(&mut self, now: u64, name: Name, session: [u8; 16], highest: u64, next: u64) -> Feedback {
        self.at = u64::MAX;
        self.last_at = Some(now);
        self.is_urgent = false;
        (self.last_bytes, self.last_next) = (self.bytes, next);
        let (echo, received_at) = self.echo.take().unwrap_or((Position { sequence: 0, index: 0 }, now));
        Feedback::Report {
            name,
            session,
            highest,
            acknowledged: next - 1,
            received_segments: self.segments,
            received_bytes: self.bytes,
            needless_bytes: self.needless_bytes,
            ce: self.ce,
            echo: echo.sequence,
            echo_index: echo.index,
            delay_us: u32::try_from((now - received_at) / 1000).unwrap_or(u32::MAX),
        }
    }
}

/// Returns the interval between reports of some bytes.
pub fn report_interval(rtt: u64) -> u64 {
    (rtt / 2).clamp(FASTEST_REPORT, SLOWEST_REPORT)
}
