//! Whose each goal is, as long as anybody may ask for it.

use std::collections::HashMap;
use std::time::Instant;

use super::cdr::MAX_GOALS;
use super::{GoalId, LINGER};

/// Goals, each of a `T`: the server that has it, or who sent it. At most [`MAX_GOALS`], of which those that have ended give way.
pub struct Goals<T> {
    goals: HashMap<GoalId, Goal<T>>,
}

struct Goal<T> {
    of: T,
    ended: Option<Instant>,
}

/// Why a goal is not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GoalsError {
    #[error("{MAX_GOALS} goals are under way; send another when some have ended")]
    Full,
    #[error("there is a goal of this id; draw another")]
    Taken,
}

impl<T> Default for Goals<T> {
    fn default() -> Self {
        Self { goals: HashMap::new() }
    }
}

impl<T: Copy + PartialEq> Goals<T> {
    /// Remembers a goal. What is somebody else's stays that.
    pub fn begin(&mut self, goal: GoalId, of: T) -> Result<(), GoalsError> {
        if let Some(known) = self.goals.get(&goal) {
            return if known.of == of { Ok(()) } else { Err(GoalsError::Taken) };
        }
        if self.goals.len() >= MAX_GOALS {
            let ended = self.goals.iter().filter_map(|(goal, known)| Some((known.ended?, *goal)));
            let (_, oldest) = ended.min().ok_or(GoalsError::Full)?;
            self.goals.remove(&oldest);
        }
        self.goals.insert(goal, Goal { of, ended: None });
        Ok(())
    }

    /// It was not accepted.
    pub fn forget(&mut self, goal: &GoalId) {
        self.goals.remove(goal);
    }

    /// It has ended, and is remembered for [`LINGER`].
    pub fn end(&mut self, now: Instant, goal: &GoalId) {
        if let Some(known) = self.goals.get_mut(goal) {
            known.ended.get_or_insert(now);
        }
    }

    /// All of these have.
    pub fn end_all(&mut self, now: Instant, of: T) {
        let all = self.goals.values_mut().filter(|known| known.of == of);
        all.for_each(|known| _ = known.ended.get_or_insert(now));
    }

    pub fn get(&self, goal: &GoalId) -> Option<T> {
        self.goals.get(goal).map(|known| known.of)
    }

    /// Whether it has goals that have not ended.
    pub fn has_live(&self, of: T) -> bool {
        self.goals.values().any(|known| known.of == of && known.ended.is_none())
    }

    /// Forgets what ended long ago.
    pub fn sweep(&mut self, now: Instant) {
        let over = |ended: Instant| now.saturating_duration_since(ended) >= LINGER;
        self.goals.retain(|_, known| !known.ended.is_some_and(over));
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn id(number: usize) -> GoalId {
        (number as u128).to_be_bytes()
    }

    #[test]
    fn a_goal_is_remembered_until_it_has_ended_for_a_while() {
        let (mut goals, start) = (Goals::default(), Instant::now());
        goals.begin(id(1), 'a').unwrap();
        goals.begin(id(2), 'b').unwrap();
        assert_eq!((goals.get(&id(1)), goals.has_live('a'), goals.get(&id(3))), (Some('a'), true, None));
        goals.end(start, &id(1));
        goals.end(start + LINGER, &id(1));
        assert!(!goals.has_live('a') && goals.has_live('b'));
        goals.sweep(start + LINGER - Duration::from_secs(1));
        assert_eq!(goals.get(&id(1)), Some('a'));
        goals.sweep(start + LINGER);
        assert_eq!((goals.get(&id(1)), goals.get(&id(2))), (None, Some('b')));
        goals.end_all(start, 'b');
        goals.sweep(start + LINGER);
        assert_eq!(goals.get(&id(2)), None);
    }

    #[test]
    fn nobody_takes_anothers_goal() {
        let mut goals = Goals::default();
        goals.begin(id(1), 'a').unwrap();
        assert_eq!((goals.begin(id(1), 'b'), goals.begin(id(1), 'a')), (Err(GoalsError::Taken), Ok(())));
        goals.forget(&id(1));
        assert_eq!(goals.begin(id(1), 'b'), Ok(()));
    }

    #[test]
    fn those_that_have_ended_give_way_and_others_do_not() {
        let (mut goals, start) = (Goals::default(), Instant::now());
        (0..MAX_GOALS).for_each(|number| goals.begin(id(number), 'a').unwrap());
        assert_eq!(goals.begin(id(MAX_GOALS), 'a'), Err(GoalsError::Full));
        goals.end(start + Duration::from_secs(1), &id(4));
        goals.end(start, &id(7));
        goals.begin(id(MAX_GOALS), 'a').unwrap();
        assert_eq!((goals.get(&id(7)), goals.get(&id(4)), goals.goals.len()), (None, Some('a'), MAX_GOALS));
    }
}
