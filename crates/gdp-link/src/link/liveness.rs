//! Tells a neighbour whose control plane died from one that is gone. QUIC ends in the daemon,
//! echoes are answered by what forwards: after a link was lost by silence, the neighbour's data
//! plane is asked until it does not answer any more.
//!
//! Sans-IO: the caller has a clock, makes cookies, sends echoes and remembers the cookie of the
//! latest answer. Answers are believed as frames are, by their tag; here it is only asked what they
//! answer. Used by nodes (`node::supervisor`) and by switches (`gdp-daemon`).

use std::collections::VecDeque;
use std::time::Duration;

use crate::port::LinkAddr;

/// How a link is probed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pace {
    /// Between two echoes.
    pub interval: Duration,
    /// So many echoes in a row without an answer end it.
    pub misses: usize,
}

impl Pace {
    /// 1 s. A cable answers in microseconds. The interface may be a Wi-Fi adapter, which is away
    /// for some hundred milliseconds when it roams or saves power.
    pub const ETHERNET: Self = Self { interval: Duration::from_millis(200), misses: 5 };

    /// 3 s: a handover between mobile cells takes one or two.
    pub const UDP: Self = Self { interval: Duration::from_millis(500), misses: 6 };

    /// The pace for a link to that address.
    pub fn of(to: LinkAddr) -> Self {
        match to {
            LinkAddr::Ethernet { .. } => Self::ETHERNET,
            LinkAddr::Udp(_) => Self::UDP,
        }
    }
}

/// What to do next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Send an echo with the cookie that was offered, and come back after [`Pace::interval`].
    Ask,
    /// The neighbour is gone. Final.
    Silent,
}

/// The echoes on a link that are not answered.
///
/// An answer proves that the neighbour lived when the echo was sent, so it settles that echo and
/// those before it and no later one; an answer to none of those that are remembered settles
/// nothing.
#[derive(Clone, Debug, Default)]
pub struct Unanswered {
    /// Their cookies, the oldest first.
    open: VecDeque<u64>,
}

impl Unanswered {
    /// Takes in the cookie of the latest answer, or anything if there was none; how many echoes are
    /// without one.
    pub fn settle(&mut self, answer: u64) -> usize {
        if let Some(settled) = self.open.iter().position(|open| *open == answer) {
            self.open.drain(..=settled);
        }
        self.open.len()
    }

    /// An echo is sent. Of more than `most` the oldest is not remembered.
    pub fn add(&mut self, cookie: u64, most: usize) {
        if self.open.len() >= most {
            self.open.pop_front();
        }
        self.open.push_back(cookie);
    }
}

/// The probing of one link. Echoes are counted, not seconds: a caller that did not run for a while
/// has asked nothing, and concludes nothing.
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

    /// One step, to be taken each [`Pace::interval`]. `answer`: the cookie of the latest answer, or
    /// anything if there was none. `cookie`: random, for the echo that may be sent now.
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
