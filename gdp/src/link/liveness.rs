//! Tells a neighbour whose control plane died from one that is gone. QUIC ends in the daemon, echoes are answered by what
//! forwards: after a link was lost by silence, the neighbour's data plane is asked until it does not answer any more.
//!
//! Sans-IO: the caller has a clock, makes cookies, sends echoes and remembers the cookie of the latest answer. Answers are
//! believed as frames are, by their tag; here it is only asked what they answer. Used by nodes (`node::supervisor`) and by
//! switches (`gdp-ctl`, `serve::liveness`).

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
    /// 1 s. A cable answers in microseconds. The interface may be a Wi-Fi adapter, which is away for some hundred milliseconds
    /// when it roams or saves power.
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
/// An answer proves that the neighbour lived when the echo was sent, so it settles that echo and those before it and no later
/// one; an answer to none of those that are remembered settles nothing.
#[derive(Clone, Debug, Default)]
pub struct Unanswered {
    /// Their cookies, the oldest first.
    open: VecDeque<u64>,
}

impl Unanswered {
    /// Takes in the cookie of the latest answer, or anything if there was none; how many echoes are without one.
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

/// The probing of one link. Echoes are counted, not seconds: a caller that did not run for a while has asked nothing, and concludes
/// nothing.
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

    /// One step, to be taken each [`Pace::interval`]. `answer`: the cookie of the latest answer, or anything if there was none.
    /// `cookie`: random, for the echo that may be sent now.
    pub fn step(&mut self, answer: u64, cookie: u64) -> Step {
        if self.open.settle(answer) >= self.pace.misses {
            return Step::Silent;
        }
        self.open.add(cookie, self.pace.misses);
        Step::Ask
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MISSES: usize = Pace::ETHERNET.misses;
    const NONE: u64 = 0;

    #[test]
    fn a_neighbour_that_answers_lives_as_long_as_it_does() {
        let mut liveness = Liveness::new(Pace::ETHERNET);
        assert!((1..1000).all(|cookie| liveness.step(cookie - 1, cookie) == Step::Ask));
        // Nothing comes any more; 999 is answered.
        let asked = (0..MISSES as u64).take_while(|n| liveness.step(999, 2000 + n) == Step::Ask).count();
        assert_eq!(asked, MISSES);
        assert_eq!(liveness.step(999, 3000), Step::Silent);
        assert_eq!(liveness.step(NONE, 3001), Step::Silent, "for good");
    }

    #[test]
    fn one_that_never_answers_is_gone_after_so_many_echoes() {
        for pace in [Pace::ETHERNET, Pace::UDP] {
            let mut liveness = Liveness::new(pace);
            let asked = (1..100).take_while(|cookie| liveness.step(NONE, *cookie) == Step::Ask).count();
            assert_eq!(asked, pace.misses);
        }
    }

    #[test]
    fn losses_between_answers_are_no_silence() {
        let mut liveness = Liveness::new(Pace::UDP);
        let mut answer = NONE;
        for cookie in 1..1000 {
            assert_eq!(liveness.step(answer, cookie), Step::Ask, "{cookie}");
            if cookie % Pace::UDP.misses as u64 == 0 {
                answer = cookie;
            }
        }
    }

    #[test]
    fn an_answer_settles_the_echoes_up_to_its_own() {
        let mut liveness = Liveness::new(Pace::ETHERNET);
        (1..=4).for_each(|cookie| assert_eq!(liveness.step(NONE, cookie), Step::Ask));
        // The answer to 2 comes late: 3 and 4 are still open.
        assert_eq!(liveness.step(2, 5), Step::Ask);
        assert_eq!(liveness.open.open, [3, 4, 5]);
        assert_eq!(liveness.step(1, 6), Step::Ask, "an older one says nothing new");
        assert_eq!(liveness.open.open, [3, 4, 5, 6]);
    }

    #[test]
    fn an_answer_to_nothing_that_is_open_is_no_sign_of_life() {
        let mut liveness = Liveness::new(Pace::ETHERNET);
        assert_eq!(liveness.step(NONE, 1), Step::Ask);
        // The answer to the first, again and again.
        let asked = (2..100).take_while(|cookie| liveness.step(1, *cookie) == Step::Ask).count();
        assert_eq!(asked, MISSES);
        let mut liveness = Liveness::new(Pace::ETHERNET);
        let asked = (1..100).take_while(|cookie| liveness.step(cookie + 1000, *cookie) == Step::Ask).count();
        assert_eq!(asked, MISSES, "made up");
    }
}
