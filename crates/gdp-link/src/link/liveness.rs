//! Detects whether the other end of a link is alive, by echoes between the data planes.
//!
//! QUIC ends in the daemon; the data plane answers echoes, with or without its daemon. So a missing
//! answer means that frames do not get through, and QUIC's silence alone does not. This is the echo
//! function of BFD (RFC 5880, section 6.4): each side sends its own echoes, at an interval that the
//! other side accepts, and a number of misses in a row is silence.
//!
//! Sans-IO: the caller provides the clock and cookies, sends one echo for each step, and passes
//! what has arrived. The tag authenticates answers as it does all frames. This module only matches
//! answers to echoes. Nodes (`node::link_tasks`) and switches (`gdp-daemon`) use it.

use std::collections::VecDeque;
use std::time::Duration;

use crate::port::LinkAddr;

/// The shortest interval between echoes that this implementation sends, and accepts from a peer.
pub const MIN_INTERVAL: Duration = Duration::from_millis(40);

/// The longest interval that a peer can demand.
const MAX_INTERVAL: Duration = Duration::from_secs(1);

/// Time without a data frame after which a link is idle.
const RECENT: Duration = Duration::from_secs(10);

/// The shortest interval between echoes on a link that is silent.
const SILENT_INTERVAL: Duration = Duration::from_millis(200);

/// The schedule of a new link until its first sign of life, 3 s at most. The peer may not have
/// installed the link yet.
const STARTING: Pace = Pace::steady(200, 15);

/// Number of steps in a row with a sign of life after which a silent link is alive again.
const RECOVERED: usize = 3;

/// The probing schedule of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pace {
    /// Time between two echoes on a link with data, or with an unanswered echo.
    pub interval: Duration,
    /// Time between two echoes on an idle link.
    pub idle: Duration,
    /// Number of consecutive unanswered echoes after which the neighbour counts as silent.
    pub misses: usize,
}

impl Pace {
    /// Of links whose peer does not negotiate, after QUIC has fallen silent. Detects silence after
    /// 1 s: a cable answers in microseconds, but a Wi-Fi adapter is unreachable for some hundred
    /// milliseconds when it roams or saves power.
    pub const ETHERNET: Self = Self::steady(200, 5);

    /// The same over UDP, after 3 s: a handover between mobile cells takes 1 s to 2 s.
    pub const UDP: Self = Self::steady(500, 6);

    const fn steady(millis: u64, misses: usize) -> Self {
        let interval = Duration::from_millis(millis);
        Self { interval, idle: interval, misses }
    }

    /// Returns the pace for a link to a peer that negotiates no echoes.
    pub fn of(to: LinkAddr) -> Self {
        match to {
            LinkAddr::Ethernet { .. } => Self::ETHERNET,
            LinkAddr::Udp(_) => Self::UDP,
        }
    }

    /// Returns the pace for a link whose peer accepts echoes at this interval. Detects silence
    /// within 240 ms on a link with data, and within 2.2 s on an idle one, unless the peer demands
    /// a longer interval.
    pub fn negotiated(accepted: Duration) -> Self {
        let interval = accepted.clamp(MIN_INTERVAL, MAX_INTERVAL);
        Self { interval, idle: Duration::from_secs(1), misses: 5 }
    }
}

/// What has arrived and left on a link until a step.
#[derive(Clone, Copy, Debug, Default)]
pub struct Evidence {
    /// The cookie of the latest answer, or any value if there was none.
    pub answer: u64,
    /// Number of frames received whose tags prove that the peer is alive, or 0 if only answers
    /// count. If both ends send echoes, the end that receives nothing detects a failure of either
    /// direction.
    pub received: u64,
    /// Number of data frames received and sent. Only changes matter.
    pub data: u64,
    /// The round-trip time of the link. Echoes are not sent faster.
    pub rtt: Duration,
}

/// The result of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// Time until the next step.
    pub wait: Duration,
    /// Whether the neighbour has become silent, or alive again.
    pub changed: bool,
}

/// The unanswered echoes of a link.
///
/// An answer proves that the neighbour was alive when the echo was sent. It therefore settles that
/// echo and all earlier ones, but no later ones. An answer to an echo that is not recorded settles
/// nothing.
#[derive(Clone, Debug, Default)]
struct Unanswered {
    /// The cookies of the unanswered echoes, oldest first.
    open: VecDeque<u64>,
}

impl Unanswered {
    /// Processes the cookie of the latest answer. Returns whether it settles an echo.
    fn settle(&mut self, answer: u64) -> bool {
        let settled = self.open.iter().position(|open| *open == answer);
        self.open.drain(..settled.map_or(0, |last| last + 1));
        settled.is_some()
    }

    /// Records an echo. Forgets the oldest one if `most` are already recorded.
    fn add(&mut self, cookie: u64, most: usize) {
        if self.open.len() >= most {
            self.open.pop_front();
        }
        self.open.push_back(cookie);
    }
}

/// The state of one link. A new link is alive.
///
/// It counts echoes, not seconds. A caller that ran late, as on a busy processor, may not have
/// received answers that have arrived. So what was unanswered then does not count.
#[derive(Clone, Debug, Default)]
pub struct Detector {
    open: Unanswered,
    silent: bool,
    /// Whether there has been a sign of life.
    started: bool,
    /// Number of steps in a row with a sign of life.
    alive: usize,
    last: Option<Last>,
    busy_until: Option<Duration>,
}

/// The step before.
#[derive(Clone, Copy, Debug)]
struct Last {
    /// When the next step was due, and how late it may be.
    due: Duration,
    slack: Duration,
    received: u64,
    data: u64,
}

impl Detector {
    pub fn is_silent(&self) -> bool {
        self.silent
    }

    /// Advances the state; call after [`Step::wait`]. The caller sends an echo with `cookie`, which
    /// is random, now. `now` counts from any start.
    pub fn step(&mut self, now: Duration, pace: Pace, sample: Evidence, cookie: u64) -> Step {
        let is_settled = self.open.settle(sample.answer);
        let is_received = self.last.is_some_and(|last| last.received != sample.received);
        self.started |= is_settled || is_received;
        let pace = if self.started || pace.idle == pace.interval { pace } else { STARTING };
        let interval = pace.interval.max(sample.rtt);
        let is_late = self.last.is_some_and(|last| now > last.due + last.slack);
        if is_received || is_late {
            self.open.open.clear();
        }
        if self.last.is_some_and(|last| last.data != sample.data) {
            self.busy_until = Some(now + RECENT);
        }
        self.alive = if is_settled || is_received { self.alive + 1 } else { 0 };
        let was_silent = self.silent;
        self.silent = match was_silent {
            true => self.alive < RECOVERED,
            false => self.open.open.len() >= pace.misses,
        };
        let is_busy = self.busy_until.is_some_and(|until| now < until);
        let wait = match () {
            () if self.silent => interval.max(SILENT_INTERVAL),
            () if is_busy || !self.open.open.is_empty() => interval,
            () => interval.max(pace.idle),
        };
        self.open.add(cookie, pace.misses);
        self.last = Some(Last { due: now + wait, slack: interval, received: sample.received, data: sample.data });
        Step { wait, changed: self.silent != was_silent }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/link/liveness.rs"]
mod tests;
