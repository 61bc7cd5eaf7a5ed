//! Selects a node's main link, and the second link for copies. No I/O.

use gdp_core::peer::MAX_LANES;

/// Time for which a preferred link must be up before it replaces the main link, in nanoseconds.
/// Without the delay, a flapping link would move the traffic each time.
pub const STABLE: u64 = 5_000_000_000;

/// The usability of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fitness {
    Down,
    /// Frames may arrive, but the switch does not confirm it.
    Doubtful,
    Up,
}

/// The selected lanes. Lane numbers are in order of preference.
#[derive(Debug, Default)]
pub struct Choice {
    main: usize,
    second: Option<usize>,
    /// The time since when each lane has been up.
    up_since: [Option<u64>; MAX_LANES],
}

impl Choice {
    pub fn main(&self) -> usize {
        self.main
    }

    /// Returns the first other lane that is up.
    pub fn second(&self) -> Option<usize> {
        self.second
    }

    /// Updates the fitness of all lanes. Returns whether the selection changed.
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

#[cfg(test)]
#[path = "../../tests/unit/node/choice.rs"]
mod tests;
