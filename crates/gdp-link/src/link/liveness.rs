//! Distinguishes a neighbour without a control plane from one that is unreachable.
//!
//! QUIC ends in the daemon; the data plane answers echoes. After a link has timed out, the caller
//! probes the neighbour's data plane until it stops answering.
//!
//! Sans-IO: the caller provides the clock and cookies, sends echoes and records the cookie of the
//! latest answer. The tag authenticates answers as it does all frames. This module only matches
//! answers to echoes. Nodes (`node::supervisor`) and switches (`gdp-daemon`) use it.

use std::collections::VecDeque;
use std::time::Duration;

use crate::port::LinkAddr;

/// The probing schedule of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pace {
    /// Time between two echoes.
    pub interval: Duration,
    /// Number of consecutive unanswered echoes after which the neighbour counts as silent.
    pub misses: usize,
}

impl Pace {
    /// Detects silence after 1 s. A cable answers in microseconds. A Wi-Fi adapter, however, is
    /// unreachable for some hundred milliseconds when it roams or saves power.
    pub const ETHERNET: Self = Self { interval: Duration::from_millis(200), misses: 5 };

    /// Detects silence after 3 s. A handover between mobile cells takes 1 s to 2 s.
    pub const UDP: Self = Self { interval: Duration::from_millis(500), misses: 6 };

    /// Returns the pace for a link to that address.
    pub fn of(to: LinkAddr) -> Self {
        match to {
            LinkAddr::Ethernet { .. } => Self::ETHERNET,
            LinkAddr::Udp(_) => Self::UDP,
        }
    }
}

/// The caller's next action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Send an echo with the cookie that was passed in, and call again after [`Pace::interval`].
    Ask,
    /// The neighbour does not answer. Final.
    Silent,
}

/// The unanswered echoes of a link.
///
/// An answer proves that the neighbour was alive when the echo was sent. It therefore settles that
/// echo and all earlier ones, but no later ones. An answer to an echo that is not recorded settles
/// nothing.
#[derive(Clone, Debug, Default)]
pub struct Unanswered {
    /// The cookies of the unanswered echoes, oldest first.
    open: VecDeque<u64>,
}

impl Unanswered {
    /// Processes the cookie of the latest answer (any value if there was none). Returns the number
    /// of unanswered echoes.
    pub fn settle(&mut self, answer: u64) -> usize {
        if let Some(settled) = self.open.iter().position(|open| *open == answer) {
            self.open.drain(..=settled);
        }
        self.open.len()
    }

    /// Returns the number of unanswered echoes.
    pub fn count(&self) -> usize {
        self.open.len()
    }

    /// Records an echo that the caller sends. Forgets the oldest echo if `most` are already
    /// recorded.
    pub fn add(&mut self, cookie: u64, most: usize) {
        if self.open.len() >= most {
            self.open.pop_front();
        }
        self.open.push_back(cookie);
    }
}

/// The probe state of one link. It counts echoes, not seconds: a caller that did not run for a
/// while has sent no echoes and detects no silence.
#[derive(Clone, Debug)]
pub struct Liveness {
    pace: Pace,
    open: Unanswered,
}

impl Liveness {
    pub fn new(pace: Pace) -> Self {
        Self { pace, open: Unanswered::default() }
    }

    pub fn pace(&self) -> Pace {
        self.pace
    }

    /// Advances the state by one step; call once per [`Pace::interval`]. `answer` is the cookie of
    /// the latest answer, or any value if there was none. `cookie` is random, for the echo that may
    /// be sent now.
    pub fn step(&mut self, answer: u64, cookie: u64) -> Step {
        if self.open.settle(answer) >= self.pace.misses {
            return Step::Silent;
        }
        self.open.add(cookie, self.pace.misses);
        Step::Ask
    }
}

#[cfg(test)]
#[path = "../../tests/unit/link/liveness.rs"]
mod tests;
