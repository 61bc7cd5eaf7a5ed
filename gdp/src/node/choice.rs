//! Chooses a node's main link, which takes everything, and its second link, which takes copies.
//! Judges also whether a link that is up is any good. No I/O.

use gdp_core::peer::MAX_LANES;
use gdp_link::link::liveness::Unanswered;

/// So long a link that is better than the main one has to be up before it becomes that: one that
/// comes and goes would otherwise take the traffic along each time.
pub const STABLE: u64 = 5_000_000_000;

/// What a link is good for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fitness {
    Down,
    /// Frames may arrive; nobody says so.
    Doubtful,
    Up,
}

/// Lanes in the order in which they are wanted, by number.
#[derive(Debug, Default)]
pub struct Choice {
    main: usize,
    second: Option<usize>,
    /// Since when each is up.
    up_since: [Option<u64>; MAX_LANES],
}

impl Choice {
    pub fn main(&self) -> usize {
        self.main
    }

    /// The first other link that is up.
    pub fn second(&self) -> Option<usize> {
        self.second
    }

    /// Takes in what the links are good for now; whether another is chosen.
    pub fn look(&mut self, now: u64, lanes: &[Fitness]) -> bool {
        let before = (self.main, self.second);
        for (since, fitness) in self.up_since.iter_mut().zip(lanes) {
            *since = if *fitness == Fitness::Up { since.or(Some(now)) } else { None };
        }
        self.main = self.best(now, lanes);
        self.second = (0..lanes.len()).find(|lane| *lane != self.main && lanes[*lane] == Fitness::Up);
        (self.main, self.second) != before
    }

    fn best(&self, now: u64, lanes: &[Fitness]) -> usize {
        let first = |wanted| lanes.iter().position(|fitness| *fitness == wanted);
        let present = lanes.get(self.main).copied().unwrap_or(Fitness::Down);
        if present == Fitness::Up {
            let is_stable = |since: &Option<u64>| since.is_some_and(|since| now.saturating_sub(since) >= STABLE);
            return self.up_since[..self.main].iter().position(is_stable).unwrap_or(self.main);
        }
        let doubtful = || if present == Fitness::Doubtful { Some(self.main) } else { first(Fitness::Doubtful) };
        first(Fitness::Up).or_else(doubtful).unwrap_or(self.main)
    }
}

/// Echoes in a row that a link may leave unanswered before another is used.
const MISSES: usize = 5;

/// Whether the other end of a link answers.
#[derive(Debug, Default)]
pub struct Pulse {
    /// The last echoes without an answer.
    open: Unanswered,
}

impl Pulse {
    /// To be called with each echo that is sent: its cookie, and the one of the latest answer, if
    /// there was any. Whether the link is silent.
    pub fn beat(&mut self, answer: u64, cookie: u64) -> bool {
        let silent = self.open.settle(answer) >= MISSES;
        self.open.add(cookie, MISSES);
        silent
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/choice.rs"]
mod tests;
