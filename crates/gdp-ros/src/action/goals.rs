//! Remembers the owner of each goal for as long as a client may request its result.

use std::collections::HashMap;
use std::time::Instant;

use super::cdr::MAX_GOALS;
use super::{GoalId, LINGER};

/// Goals with their owners. The owner `T` is the goal's server or its client. At most [`MAX_GOALS`]
/// goals are stored; a new goal replaces the one that ended first.
pub struct Goals<T> {
    goals: HashMap<GoalId, Goal<T>>,
}

struct Goal<T> {
    of: T,
    ended: Option<Instant>,
}

/// The reason why a goal is refused.
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
    /// Stores a goal. Fails if the goal has another owner, or if [`MAX_GOALS`] goals are active.
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

    /// Removes a goal that the server has not accepted.
    pub fn forget(&mut self, goal: &GoalId) {
        self.goals.remove(goal);
    }

    /// Marks a goal as ended. It stays for [`LINGER`].
    pub fn end(&mut self, now: Instant, goal: &GoalId) {
        if let Some(known) = self.goals.get_mut(goal) {
            known.ended.get_or_insert(now);
        }
    }

    /// Marks all goals of an owner as ended.
    pub fn end_all(&mut self, now: Instant, of: T) {
        let all = self.goals.values_mut().filter(|known| known.of == of);
        all.for_each(|known| _ = known.ended.get_or_insert(now));
    }

    pub fn get(&self, goal: &GoalId) -> Option<T> {
        self.goals.get(goal).map(|known| known.of)
    }

    /// Returns whether an owner has active goals.
    pub fn has_live(&self, of: T) -> bool {
        self.goals.values().any(|known| known.of == of && known.ended.is_none())
    }

    /// Removes goals that ended [`LINGER`] ago.
    pub fn sweep(&mut self, now: Instant) {
        let over = |ended: Instant| now.saturating_duration_since(ended) >= LINGER;
        self.goals.retain(|_, known| !known.ended.is_some_and(over));
    }
}

#[cfg(test)]
#[path = "../../tests/unit/action/goals.rs"]
mod tests;
