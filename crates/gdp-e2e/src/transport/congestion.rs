//! Congestion control for the path to one reader: a model after BBR, fed by reports. See Cardwell
//! et al., "BBR: Congestion-Based Congestion Control", 2016, and draft-ietf-ccwg-bbr. The model
//! consists of delivery rate and round-trip time. Single losses, which radio links always have, do
//! not slow the path down. Many losses in a round do, and so do marks. `docs/decisions.md` explains
//! why no existing controller is used.

use super::delivery_rate::RateSample;
use super::meter::nanoseconds;
use super::reports::SOME_BYTES;
use super::{FRAME_HEADER, MS};

/// A full frame in bytes, for limits in frames.
const FRAME: u64 = 1400 + FRAME_HEADER;

/// Initial window in bytes. RFC 6928 recommends 10 frames; large senders use up to this many today.
pub const INITIAL_WINDOW: u64 = 32 * FRAME;
/// Minimum window of a path: what a reader may leave unreported, and a few frames.
pub const MIN_WINDOW: u64 = SOME_BYTES + 4 * FRAME;

/// On a path with a shorter round trip, a thread that waits for a processor is away for many round
/// trips. What is measured then says nothing about the path. So such a path has at least
/// [`LOCAL_WINDOW`] in bytes, sent within [`LOCAL_BURST`], until it shows congestion.
const LOCAL_RTT: u64 = MS;
const LOCAL_WINDOW: u64 = 1 << 20;
const LOCAL_BURST: u64 = 2 * MS;
/// A local path whose round trips were all longer than the shortest by this, in the last
/// [`QUEUE_TIME`] or two, has a queue. On a busy host some are short.
const QUEUE: u64 = 5 * MS;
const QUEUE_TIME: u64 = 100 * MS;
/// Time after congestion in which a local path is measured as every other.
const LOCAL_AGAIN: u64 = 10_000 * MS;
/// Bytes that a late thread may always catch up on at once.
const LATE_BYTES: u64 = 64 << 10;

/// Burst after a pause, as time at the known rate of the path. A topic with few and short messages
/// measures only a small part of the path's capacity. Without the burst, it would be limited to
/// that part.
const BURST_TIME: u64 = 20 * MS;

/// Assumed round-trip time before the first measurement.
const INITIAL_RTT: u64 = 20 * MS;
/// Lifetime of the shortest round-trip time. Afterwards the queue is drained to measure it again.
const RTT_WINDOW: u64 = 10_000 * MS;
const DRY_TIME: u64 = 200 * MS;

/// Doubles the rate each round (2/ln 2), in percent.
const STARTUP_GAIN: u64 = 289;
/// Gains of the rate in the phases of steady state, in percent.
const CYCLE: [u64; 8] = [125, 75, 100, 100, 100, 100, 100, 100];
const SHORTEST_ATTEMPT: u64 = 2 * MS;
/// Number of rounds that a measured rate is valid for.
const RATE_ROUNDS: u64 = 10;
/// Number of rounds with less than a quarter of growth that end the startup.
const FULL_ROUNDS: u32 = 3;

/// Upper limit of a path's rate in bytes per second; products with it fit 64 bits.
const MAX_RATE: u128 = 1 << 40;

/// Share of losses in a round that indicates congestion, in percent. Radio links lose up to a tenth
/// without congestion.
const LOSS_LIMIT: u64 = 15;
/// Reduction of the rate after a round with congestion, in percent of the rate.
const BACK_OFF: u64 = 80;
/// Number of rounds in which a reduction is undone if its losses prove to be needless requests.
const UNDO_ROUNDS: u64 = 16;

/// The measurements of a report.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sample {
    /// Round-trip time of the frame that the report echoes. `None` if the frame was sent more than
    /// once.
    pub rtt: Option<u64>,
    /// Bytes received since the previous report.
    pub delivered: u64,
    pub rate: RateSample,
    /// The topic had nothing to send since the previous report.
    pub paused: bool,
    /// Bytes that were requested again.
    pub lost: u64,
    /// Bytes of earlier requests that were needless: their first transmission arrived as well.
    pub needless: u64,
    /// Frames received with a mark.
    pub marks: u64,
    /// Bytes of the topic that the report covers, and all bytes sent.
    pub acknowledged: u64,
    pub sent: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Startup,
    /// Drains the queue of the startup.
    Drain,
    /// Follows [`CYCLE`]; `since` is the start of the step.
    Steady {
        step: usize,
        since: u64,
    },
    /// Halves the window until `until`, to measure the shortest round-trip time.
    Dry {
        until: u64,
    },
}

#[derive(Clone, Debug)]
pub struct Path {
    phase: Phase,
    smoothed_rtt: Option<u64>,
    min_rtt: Option<u64>,
    min_rtt_at: u64,
    /// Smoothed interval between reports.
    report_interval: u64,
    last_report: Option<u64>,
    rates: MaxRate,
    /// Number of the round. A round lasts until the bytes in flight at its start have been
    /// reported.
    round: u64,
    round_ends: u64,
    round_delivered: u64,
    round_lost: u64,
    round_marks: u64,
    /// The shortest round-trip time of the round.
    round_rtt: u64,
    full_rate: u64,
    full_rounds: u32,
    /// Upper limit of the rate after congestion, until the next probe for bandwidth.
    ceiling: Option<u64>,
    /// The shortest round-trip times of the last two periods of [`QUEUE_TIME`], the current one
    /// first, and the start of that.
    recent_rtt: [u64; 2],
    recent_since: u64,
    /// Time until which a local path is measured as every other.
    congested_until: u64,
    /// See [`Self::catch_up`].
    overflowed_until: u64,
    /// The state before the reductions of the last rounds.
    undo: Option<Undo>,
    /// Number of bytes that were in flight when reports stopped.
    silent: Option<u64>,
}

/// The state before losses reduced the rate, as in Eifel (RFC 4015).
#[derive(Clone, Copy, Debug)]
struct Undo {
    round: u64,
    phase: Phase,
    ceiling: Option<u64>,
    congested_until: u64,
    overflowed_until: u64,
    /// Bytes of the rounds that reduced the rate: received, requested again, and needlessly so.
    seen: u64,
    lost: u64,
    needless: u64,
}

impl Path {
    pub fn new() -> Self {
        Self {
            phase: Phase::Startup,
            smoothed_rtt: None,
            min_rtt: None,
            min_rtt_at: 0,
            report_interval: 10 * MS,
            last_report: None,
            rates: MaxRate::default(),
            round: 0,
            round_ends: 0,
            round_delivered: 0,
            round_lost: 0,
            round_marks: 0,
            round_rtt: u64::MAX,
            full_rate: 0,
            full_rounds: 0,
            ceiling: None,
            recent_rtt: [0; 2],
            recent_since: 0,
            congested_until: 0,
            overflowed_until: 0,
            undo: None,
            silent: None,
        }
    }

    /// Reduces the window until the next report, to test whether the path still exists.
    /// `under_way`: bytes in flight.
    pub fn on_silence(&mut self, under_way: u64) {
        self.silent = Some(self.silent.unwrap_or(0) + under_way);
    }

    pub fn is_silent(&self) -> bool {
        self.silent.is_some()
    }

    /// Processes a report. Returns whether the report indicates congestion. Losses of frames sent
    /// before then must count only once.
    pub fn on_report(&mut self, now: u64, sample: &Sample) -> bool {
        if let Some(last) = self.last_report {
            let interval = (now - last).min(100 * MS);
            self.report_interval = (7 * self.report_interval + interval) / 8;
        }
        self.last_report = Some(now);
        if let Some(under_way) = self.silent.take() {
            if sample.delivered >= under_way - under_way / 8 {
                // The reader, or its reports, were late.
                return false;
            }
            // The path may have changed.
            *self = Self {
                smoothed_rtt: self.smoothed_rtt,
                last_report: Some(now),
                round_ends: sample.sent,
                congested_until: now + LOCAL_AGAIN,
                overflowed_until: self.overflowed_until,
                ..Self::new()
            };
            return false;
        }
        if let Some(rtt) = sample.rtt {
            self.measure_rtt(now, rtt.max(1));
        }
        self.round_delivered += sample.delivered;
        self.round_lost += sample.lost;
        self.undo_needless(sample.needless);
        self.round_marks += sample.marks;
        let RateSample { bytes, interval, paused } = sample.rate;
        if bytes > 0 && interval > 0 {
            let rate = bytes_per_second(bytes, interval);
            if !paused || rate > self.rates.get() {
                self.rates.add(self.round, rate);
            }
        }
        let mut congested = false;
        if sample.acknowledged >= self.round_ends {
            congested = self.end_round(sample.paused);
            if congested {
                (self.congested_until, self.overflowed_until) = (now + LOCAL_AGAIN, now + LOCAL_AGAIN);
            }
            self.undo.take_if(|undo| self.round > undo.round + UNDO_ROUNDS);
            self.round += 1;
            self.round_ends = sample.sent;
        }
        self.advance(now, sample);
        congested
    }

    /// Returns the send rate in bytes per second.
    pub fn rate(&self, now: u64) -> u64 {
        let gain = match self.phase {
            // A probe for bandwidth builds a queue, so it ends on time even if the next report is
            // late.
            Phase::Steady { step: 0, since }
                if now.saturating_sub(since) > self.min_rtt.unwrap_or(0).max(SHORTEST_ATTEMPT) =>
            {
                100
            }
            Phase::Startup => STARTUP_GAIN,
            Phase::Drain => 50,
            Phase::Steady { step, .. } => CYCLE[step],
            Phase::Dry { .. } => 100,
        };
        let least = match self.is_local() {
            true => bytes_per_second(LOCAL_WINDOW, LOCAL_BURST),
            false => bytes_per_second(MIN_WINDOW, self.rtt() + self.report_interval),
        };
        (self.bandwidth() * gain / 100).max(least)
    }

    /// Returns the maximum number of bytes in flight.
    pub fn window(&self) -> u64 {
        if self.rates.get() == 0 || self.is_silent() {
            return INITIAL_WINDOW;
        }
        let rtt = self.min_rtt.unwrap_or(INITIAL_RTT);
        let least = if self.is_local() { LOCAL_WINDOW } else { MIN_WINDOW };
        match self.phase {
            Phase::Startup => (self.in_flight(rtt) * STARTUP_GAIN / 100).max(INITIAL_WINDOW.max(least)),
            Phase::Drain | Phase::Steady { .. } => (2 * self.in_flight(rtt)).max(least),
            Phase::Dry { .. } => (self.in_flight(rtt) / 2).max(MIN_WINDOW),
        }
    }

    /// Returns whether the path is so short that waiting for processors would dominate all
    /// measurements, and shows no congestion.
    fn is_local(&self) -> bool {
        let is_short = self.min_rtt.is_some_and(|rtt| rtt < LOCAL_RTT);
        is_short && self.last_report.is_some_and(|now| now >= self.congested_until)
    }

    /// Returns the nanoseconds that a late thread may catch up on at once. A queue that has
    /// overflowed within [`LOCAL_AGAIN`] before the last report may be short.
    pub fn catch_up(&self, rate: u64) -> u64 {
        let has_overflowed = self.last_report.is_some_and(|now| now < self.overflowed_until);
        if has_overflowed { nanoseconds(LATE_BYTES, rate).max(self.min_rtt.unwrap_or(0) / 4) } else { u64::MAX }
    }

    /// Returns the burst in bytes when nothing is in flight and nothing was sent for a round trip.
    pub fn burst(&self) -> u64 {
        let is_known = self.rates.get() > 0 && !self.is_silent();
        if is_known { bytes_in(self.bandwidth(), BURST_TIME).min(INITIAL_WINDOW) } else { 0 }
    }

    /// Returns the smoothed round-trip time.
    pub fn rtt(&self) -> u64 {
        self.smoothed_rtt.unwrap_or(INITIAL_RTT)
    }

    /// Returns the maximum time of a repair, if the path does not become slower.
    pub fn repair_time(&self) -> u64 {
        (4 * self.min_rtt.unwrap_or(INITIAL_RTT) + 4 * self.report_interval).clamp(200 * MS, 1_000 * MS)
    }

    /// Returns the time until a report about a frame sent now is overdue.
    pub fn timeout_factor(&self) -> u64 {
        (2 * self.rtt() + 3 * self.report_interval).max(100 * MS)
    }

    /// Returns the measured capacity of the path in bytes per second.
    fn bandwidth(&self) -> u64 {
        let rate = self.rates.get();
        if self.phase == Phase::Startup {
            return rate.max(bytes_per_second(INITIAL_WINDOW, self.rtt() + self.report_interval));
        }
        rate.min(self.ceiling.unwrap_or(u64::MAX))
    }

    /// Returns the unreported bytes of a path that is full and has no queue.
    fn in_flight(&self, rtt: u64) -> u64 {
        bytes_in(self.bandwidth(), rtt + self.report_interval) + 2 * FRAME
    }

    /// Returns the same directly after a report.
    fn queueless(&self, rtt: u64) -> u64 {
        bytes_in(self.bandwidth(), rtt + rtt / 8) + 2 * FRAME
    }

    fn measure_rtt(&mut self, now: u64, rtt: u64) {
        self.round_rtt = self.round_rtt.min(rtt);
        if now >= self.recent_since + QUEUE_TIME {
            self.recent_rtt = [rtt, self.recent_rtt[0]];
            self.recent_since = now;
        }
        self.recent_rtt[0] = self.recent_rtt[0].min(rtt);
        let recent = self.recent_rtt[0].min(self.recent_rtt[1]);
        if self.min_rtt.is_some_and(|shortest| recent > shortest + QUEUE) {
            self.congested_until = now + LOCAL_AGAIN;
        }
        self.smoothed_rtt = Some(self.smoothed_rtt.map_or(rtt, |smoothed| (7 * smoothed + rtt) / 8));
        let dry = matches!(self.phase, Phase::Dry { .. });
        let expired = dry && now.saturating_sub(self.min_rtt_at) > RTT_WINDOW;
        if expired || self.min_rtt.is_none_or(|min| rtt <= min) {
            self.min_rtt = Some(rtt);
            self.min_rtt_at = now;
        }
    }

    /// Restores the state before reductions whose losses were needless requests.
    fn undo_needless(&mut self, needless: u64) {
        // Those of the current round have reduced nothing yet.
        let current = needless.min(self.round_lost);
        self.round_lost -= current;
        let Some(undo) = &mut self.undo else { return };
        undo.needless += needless - current;
        if !is_lossy(undo.lost.saturating_sub(undo.needless), undo.seen) {
            let Undo { phase, ceiling, congested_until, overflowed_until, .. } = *undo;
            (self.phase, self.ceiling) = (phase, ceiling);
            (self.congested_until, self.overflowed_until) = (congested_until, overflowed_until);
            self.undo = None;
        }
    }

    fn end_round(&mut self, paused: bool) -> bool {
        let seen = self.round_delivered + self.round_lost;
        let lossy = is_lossy(self.round_lost, seen);
        let congested = self.round_marks > 0 || lossy;
        if self.round_marks > 0 {
            self.undo = None;
        } else if lossy {
            let undo = self.undo.get_or_insert(Undo {
                round: self.round,
                phase: self.phase,
                ceiling: self.ceiling,
                congested_until: self.congested_until,
                overflowed_until: self.overflowed_until,
                seen: 0,
                lost: 0,
                needless: 0,
            });
            (undo.seen, undo.lost) = (undo.seen + seen, undo.lost + self.round_lost);
        }
        if congested {
            self.ceiling = Some(self.bandwidth() * BACK_OFF / 100);
            if self.phase == Phase::Startup {
                self.phase = Phase::Drain;
            }
        }
        (self.round_delivered, self.round_lost, self.round_marks) = (0, 0, 0);
        if self.phase == Phase::Startup && !paused {
            if self.rates.get() >= self.full_rate + self.full_rate / 4 {
                (self.full_rate, self.full_rounds) = (self.rates.get(), 0);
            } else {
                self.full_rounds += 1;
            }
            // A queue during the whole round also indicates a full path.
            let empty = self.min_rtt.unwrap_or(INITIAL_RTT);
            let stands = self.round_rtt < u64::MAX && self.round_rtt > empty + empty / 2 + 2 * MS;
            self.full_rounds += u32::from(stands);
            if self.full_rounds >= FULL_ROUNDS {
                self.phase = Phase::Drain;
            }
        }
        self.round_rtt = u64::MAX;
        congested
    }

    fn advance(&mut self, now: u64, sample: &Sample) {
        let under_way = sample.sent.saturating_sub(sample.acknowledged);
        let rtt = self.min_rtt.unwrap_or(INITIAL_RTT);
        match self.phase {
            Phase::Drain if under_way <= self.queueless(rtt) => self.begin_steady(now),
            // The queue of a probe for bandwidth is drained first.
            Phase::Steady { step, since }
                if now.saturating_sub(since) >= rtt.max(self.report_interval)
                    && (CYCLE[step] >= 100 || under_way <= self.queueless(rtt)) =>
            {
                let step = (step + 1) % CYCLE.len();
                if CYCLE[step] > 100 {
                    self.ceiling = None;
                }
                self.phase = Phase::Steady { step, since: now };
            }
            Phase::Dry { until } if now >= until => {
                self.min_rtt_at = now;
                self.begin_steady(now);
            }
            _ => {}
        }
        let stale = now.saturating_sub(self.min_rtt_at) > RTT_WINDOW;
        if stale && sample.paused {
            // The queue has drained by itself.
            (self.min_rtt, self.min_rtt_at) = (sample.rtt.or(self.min_rtt), now);
        } else if stale && matches!(self.phase, Phase::Steady { .. }) && self.min_rtt.is_some() {
            self.phase = Phase::Dry { until: now + DRY_TIME.max(rtt + self.report_interval) };
        }
    }

    /// Starts at a step that differs between flows, so that they do not probe at the same time.
    fn begin_steady(&mut self, now: u64) {
        let step = 2 + (now / 1000 % 6) as usize;
        self.phase = Phase::Steady { step, since: now };
    }
}

/// The highest rate of the last rounds.
#[derive(Clone, Copy, Debug, Default)]
struct MaxRate {
    /// Maxima of the rounds from `RATE_ROUNDS / 2 * n` on, newest first.
    buckets: [(u64, u64); 3],
}

impl MaxRate {
    fn add(&mut self, round: u64, rate: u64) {
        let bucket = round / (RATE_ROUNDS / 2);
        if self.buckets[0].0 != bucket {
            self.buckets.rotate_right(1);
            self.buckets[0] = (bucket, 0);
        }
        self.buckets[0].1 = self.buckets[0].1.max(rate);
        for (of, rate) in &mut self.buckets[1..] {
            if bucket - *of > 2 {
                *rate = 0;
            }
        }
    }

    fn get(&self) -> u64 {
        self.buckets.iter().map(|(_, rate)| *rate).max().unwrap_or(0)
    }
}

/// Returns whether so many of the bytes were lost that the path is congested.
fn is_lossy(lost: u64, seen: u64) -> bool {
    lost > 4 * FRAME && lost * 100 > seen * LOSS_LIMIT
}

fn bytes_in(rate: u64, nanoseconds: u64) -> u64 {
    (u128::from(rate) * u128::from(nanoseconds) / 1_000_000_000) as u64
}

fn bytes_per_second(bytes: u64, nanoseconds: u64) -> u64 {
    (u128::from(bytes) * 1_000_000_000 / u128::from(nanoseconds.max(1))).min(MAX_RATE) as u64
}

#[cfg(test)]
#[path = "../../tests/unit/transport/congestion.rs"]
mod tests;
