//! Which of a node's links is the main one, that everything goes by, and which is the second, that copies go by; and whether one that
//! is up is any good. No I/O.

use crate::link::MAX_LANES;
use crate::link::liveness::Unanswered;

/// So long a link that is better than the main one has to be up before it becomes that: one that comes and goes would otherwise take
/// the traffic along each time.
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
    /// To be called with each echo that is sent: its cookie, and the one of the latest answer, if there was any. Whether the link is
    /// silent.
    pub fn beat(&mut self, answer: u64, cookie: u64) -> bool {
        let silent = self.open.settle(answer) >= MISSES;
        self.open.add(cookie, MISSES);
        silent
    }
}

#[cfg(test)]
mod tests {
    use super::Fitness::{Doubtful, Down, Up};
    use super::*;

    #[test]
    fn what_is_lost_is_left_at_once_and_returned_to_once_it_is_stable() {
        let mut choice = Choice::default();
        let mut look = |now, lanes: [Fitness; 3]| {
            choice.look(now, &lanes);
            (choice.main(), choice.second())
        };
        assert_eq!(look(0, [Down, Up, Down]), (1, None), "the first that is up");
        assert_eq!(look(1, [Up, Up, Up]), (1, Some(0)));
        assert_eq!(look(STABLE, [Up, Up, Up]), (1, Some(0)), "not yet");
        assert_eq!(look(STABLE + 1, [Up, Up, Up]), (0, Some(1)));
        assert_eq!(look(STABLE + 2, [Doubtful, Up, Up]), (1, Some(2)));
        assert_eq!(look(STABLE + 3, [Up, Up, Up]), (1, Some(0)));
        assert_eq!(look(2 * STABLE, [Doubtful, Up, Up]), (1, Some(2)), "it comes and goes");
        assert_eq!(look(2 * STABLE + 1, [Up, Up, Up]), (1, Some(0)));
        assert_eq!(look(3 * STABLE, [Up, Up, Up]), (1, Some(0)), "so it waits anew");
        assert_eq!(look(3 * STABLE + 1, [Up, Up, Up]), (0, Some(1)));
    }

    #[test]
    fn a_doubtful_link_is_better_than_none() {
        let mut choice = Choice::default();
        let mut look = |lanes: [Fitness; 2]| {
            choice.look(0, &lanes);
            (choice.main(), choice.second())
        };
        assert_eq!(look([Up, Up]), (0, Some(1)));
        assert_eq!(look([Doubtful, Doubtful]), (0, None), "it stays where it is");
        assert_eq!(look([Down, Doubtful]), (1, None));
        assert_eq!(look([Down, Down]), (1, None));
        assert_eq!(look([Doubtful, Down]), (0, None));
    }

    #[test]
    fn a_link_is_silent_until_it_answers_one_of_the_last_echoes() {
        let mut pulse = Pulse::default();
        assert!((1..100).all(|cookie| !pulse.beat(cookie - 1, cookie)));
        let silent: Vec<bool> = (100..110).map(|cookie| pulse.beat(98, cookie)).collect();
        assert_eq!(silent.iter().position(|silent| *silent), Some(MISSES - 1), "99 was open");
        assert!(silent[MISSES..].iter().all(|silent| *silent));
        assert!(pulse.beat(101, 110), "too old");
        assert!(!pulse.beat(108, 111));
    }

    #[test]
    fn nothing_changes_without_reason() {
        let mut choice = Choice::default();
        assert!(choice.look(0, &[Up, Up]), "a second");
        assert!(!choice.look(1, &[Up, Up]));
        assert!(!choice.look(9 * STABLE, &[Up, Up]));
        assert!(choice.look(9 * STABLE, &[Up, Down]));
    }
}
