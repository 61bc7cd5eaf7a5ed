//! The rate at which bytes arrive at a reader, over a time that is not too short. A thread that had
//! no processor sends in a burst, and processes several reports at once.

use std::collections::VecDeque;

use super::MS;
use super::sent_log::Sent;

/// Minimum length of a sample in nanoseconds, and of one that begins with a pause of the topic.
const LENGTH: u64 = 2 * MS;
const LENGTH_AFTER_PAUSE: u64 = MS;

/// Maximum number of remembered reports. Beyond it, every other one is forgotten.
const MOST: usize = 64;

/// Bytes that arrived in a time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RateSample {
    pub bytes: u64,
    /// Nanoseconds in which they were sent or reported, whichever is longer.
    pub interval: u64,
    /// The topic had nothing to send in between, so the sample says little about the path.
    pub paused: bool,
}

/// What had arrived at the time of each of the last reports.
#[derive(Debug)]
pub struct DeliveryRate {
    /// Bytes so far.
    total: u64,
    reports: VecDeque<ReportedArrival>,
}

/// A report.
#[derive(Clone, Copy, Debug)]
struct ReportedArrival {
    at: u64,
    total: u64,
    /// When the last frame that had arrived was sent for the first time.
    sent_at: u64,
    /// Number of pauses of the topic before that frame. `None` when the reader joined.
    pauses: Option<u64>,
}

impl DeliveryRate {
    pub fn new(now: u64) -> Self {
        let first = ReportedArrival { at: now, total: 0, sent_at: now, pauses: None };
        Self { total: 0, reports: VecDeque::from([first]) }
    }

    /// Adds a report that `bytes` more have arrived. `latest` is the last frame of first
    /// transmissions that has. Returns the arrivals since the topic's last pause, in the last
    /// [`LENGTH`] or longer. If that pause was just now, the sample includes it.
    pub fn add(&mut self, now: u64, bytes: u64, latest: &Sent) -> RateSample {
        self.total += bytes;
        while self.reports.get(1).is_some_and(|second| second.at + LENGTH <= now) {
            self.reports.pop_front();
        }
        let since = |report: &ReportedArrival| RateSample {
            bytes: self.total - report.total,
            interval: now.saturating_sub(report.at).max(latest.at.saturating_sub(report.sent_at)),
            paused: report.pauses.is_some_and(|pauses| pauses != latest.pauses),
        };
        let resumed = self.reports.iter().map(since).find(|sample| !sample.paused);
        let resumed = resumed.filter(|sample| sample.interval >= LENGTH_AFTER_PAUSE);
        let sample = resumed.or_else(|| self.reports.front().map(since)).unwrap_or_default();
        // Later samples do not begin when the reader joined.
        self.reports.pop_front_if(|first| first.pauses.is_none());
        if self.reports.len() >= MOST {
            let mut is_kept = false;
            self.reports.retain(|_| {
                is_kept = !is_kept;
                is_kept
            });
        }
        self.reports.push_back(ReportedArrival {
            at: now,
            total: self.total,
            sent_at: latest.at,
            pauses: Some(latest.pauses),
        });
        sample
    }
}

#[cfg(test)]
#[path = "../../tests/unit/transport/delivery_rate.rs"]
mod tests;
