//! A client of one action server of ROS 1, on behalf of clients elsewhere.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use bytes::Bytes;

use super::message::{self, GoalStatus, Time};
use super::status;
use crate::action::cdr::{self, ANY_GOAL, Canceling, Stamp, Status};
use crate::action::{GoalId, GoalsError, LINGER};

/// Maximum number of goals. A new goal replaces the one that ended first.
const MAX_SENT: usize = 1024;

/// Maximum size of all stored results, in bytes. Beyond it the oldest are dropped.
const MAX_RESULTS: usize = 32 << 20;

/// Time after which a goal is lost if the server's status lists no longer name it. A server lists a
/// goal for 5 s after its end.
const LOST: Duration = Duration::from_secs(10);

/// Time for which an ended goal is still listed, as ROS 2 servers do it.
const LISTED: Duration = Duration::from_secs(10);

/// The goals that were sent to one server.
pub struct GoalClient {
    /// The start of the goals' IDs in ROS 1. The rest is the ID in ROS 2.
    prefix: String,
    goals: HashMap<GoalId, SentGoal>,
    result_bytes: usize,
}

struct SentGoal {
    /// The time of arrival on the server's clock, from its first status list with the goal.
    stamp: Stamp,
    status: u8,
    /// Whether the server has named the goal.
    is_known: bool,
    /// The last time that the server named the goal, or that it was sent.
    named: Instant,
    ended: Option<Instant>,
    outcome: Option<GoalOutcome>,
}

/// Whether a server has accepted a goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Accepted {
    Yes(Stamp),
    No,
    /// The server does not know the goal.
    Lost,
}

/// The end of a goal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum GoalOutcome {
    /// The status of ROS 1, and the result in the form that the caller stored.
    Result(u8, Bytes),
    /// The server has ended the goal without a result, or has lost it.
    Lost,
    /// No such goal, or its result is not stored any more.
    Unknown,
}

impl SentGoal {
    fn take_stamp(&mut self, status: &GoalStatus) {
        if !self.is_known {
            let (seconds, nanoseconds) = status.goal.stamp;
            self.stamp = (seconds.try_into().unwrap_or(i32::MAX), nanoseconds);
        }
    }
}

impl GoalClient {
    /// `node` is the name of the proxy's node.
    pub fn new(node: &str) -> Self {
        Self { prefix: format!("{node}-"), goals: HashMap::new(), result_bytes: 0 }
    }

    /// Stores a goal that is about to be sent. Returns its ID in ROS 1. It has no stamp, so that
    /// the server sets one: its clock may differ, or be that of a simulation.
    pub fn begin(&mut self, now: Instant, goal: GoalId) -> Result<message::GoalId, GoalsError> {
        if self.goals.contains_key(&goal) {
            return Err(GoalsError::Taken);
        }
        if self.goals.len() >= MAX_SENT {
            let ended = self.goals.iter().filter_map(|(goal, sent)| Some((sent.ended?, *goal)));
            let (_, oldest) = ended.min().ok_or(GoalsError::Full)?;
            self.remove(&oldest);
        }
        let (stamp, status, is_known, ended, outcome) = (Stamp::default(), status::PENDING, false, None, None);
        self.goals.insert(goal, SentGoal { stamp, status, is_known, named: now, ended, outcome });
        Ok(message::GoalId { stamp: Time::default(), id: self.id(&goal) })
    }

    fn id(&self, goal: &GoalId) -> String {
        format!("{}{:032x}", self.prefix, u128::from_be_bytes(*goal))
    }

    /// Returns the goal of an ID in ROS 1. It is `None` for goals of other clients.
    pub fn goal(&self, id: &str) -> Option<GoalId> {
        let digits = id.strip_prefix(&self.prefix)?;
        let goal = u128::from_str_radix(digits, 16).ok()?.to_be_bytes();
        (self.goals.contains_key(&goal) && self.id(&goal) == id).then_some(goal)
    }

    /// Takes a status list of the server. Returns whether anything has changed.
    pub fn take_statuses(&mut self, now: Instant, statuses: &[GoalStatus]) -> bool {
        let mut has_changed = false;
        for status in statuses {
            has_changed |= self.goal(&status.goal.id).is_some_and(|goal| self.take_status(now, &goal, status));
        }
        for sent in self.goals.values_mut().filter(|sent| sent.outcome.is_none()) {
            if now.saturating_duration_since(sent.named) >= LOST {
                sent.ended.get_or_insert(now);
                (sent.outcome, has_changed) = (Some(GoalOutcome::Lost), true);
                sent.status = if status::is_final(sent.status) { sent.status } else { status::LOST };
            }
        }
        has_changed
    }

    fn take_status(&mut self, now: Instant, goal: &GoalId, status: &GoalStatus) -> bool {
        let Some(sent) = self.goals.get_mut(goal) else { return false };
        sent.named = now;
        sent.take_stamp(status);
        let status = status.status;
        // The lists and the results come over several connections, so a list may be old.
        if sent.ended.is_some() || (sent.is_known && sent.status == status) || status > status::LOST {
            return false;
        }
        (sent.is_known, sent.status) = (true, status);
        if status::is_final(status) {
            sent.ended = Some(now);
        }
        true
    }

    /// Ends a goal whose result is not usable.
    pub fn lose(&mut self, now: Instant, goal: &GoalId) {
        let Some(sent) = self.goals.get_mut(goal).filter(|sent| sent.outcome.is_none()) else { return };
        sent.ended.get_or_insert(now);
        (sent.status, sent.outcome) = (status::LOST, Some(GoalOutcome::Lost));
    }

    /// Removes a goal that could not be sent.
    pub fn forget(&mut self, goal: &GoalId) {
        self.remove(goal);
    }

    /// Stores a result. Further results of a goal are ignored.
    pub fn take_result(&mut self, now: Instant, goal: &GoalId, status: &GoalStatus, result: Bytes) {
        let Some(sent) = self.goals.get_mut(goal).filter(|sent| sent.outcome.is_none()) else { return };
        sent.take_stamp(status);
        let status = status::of_result(status.status);
        self.result_bytes += result.len();
        sent.ended.get_or_insert(now);
        (sent.is_known, sent.status, sent.outcome) = (true, status, Some(GoalOutcome::Result(status, result)));
        while self.result_bytes > MAX_RESULTS {
            // Whoever waits for this result has not read it yet.
            let others = self.goals.iter().filter(|(other, _)| *other != goal);
            let stored = others.filter(|(_, sent)| matches!(sent.outcome, Some(GoalOutcome::Result(..))));
            let Some((_, oldest)) = stored.map(|(goal, sent)| (sent.ended, *goal)).min() else { break };
            self.remove(&oldest);
        }
    }

    /// Returns whether the server has accepted a goal, or `None` while it has not answered.
    pub fn accepted(&self, goal: &GoalId) -> Option<Accepted> {
        let Some(sent) = self.goals.get(goal) else { return Some(Accepted::Lost) };
        match (sent.is_known, &sent.outcome) {
            (true, _) if sent.status == status::REJECTED => Some(Accepted::No),
            (true, _) => Some(Accepted::Yes(sent.stamp)),
            (false, Some(_)) => Some(Accepted::Lost),
            (false, None) => None,
        }
    }

    /// Returns the end of a goal, or `None` while it has not ended.
    pub fn outcome(&self, goal: &GoalId) -> Option<GoalOutcome> {
        self.goals.get(goal).map_or(Some(GoalOutcome::Unknown), |sent| sent.outcome.clone())
    }

    /// Translates a request to cancel goals. Returns what to publish on `cancel`, and the response.
    /// The server does not answer, so all goals count as canceling that it may cancel.
    pub fn cancel(&self, goal: GoalId, stamp: Stamp) -> (Option<message::GoalId>, Canceling) {
        const UNKNOWN_GOAL: i8 = 2;
        const TERMINATED: i8 = 3;
        let (is_any, has_stamp) = (goal == ANY_GOAL, stamp != Stamp::default());
        let refused = match self.goals.get(&goal) {
            _ if is_any || has_stamp => None,
            None => Some(UNKNOWN_GOAL),
            Some(sent) => sent.ended.map(|_| TERMINATED),
        };
        if let Some(code) = refused {
            return (None, Canceling { code, goals: vec![] });
        }
        let is_meant = |id: &GoalId, sent: &SentGoal| match (is_any, has_stamp) {
            (true, false) => true,
            (_, true) if sent.stamp <= stamp => true,
            _ => *id == goal,
        };
        let goals = self.goals.iter().filter(|(id, sent)| sent.ended.is_none() && is_meant(id, sent));
        let goals = goals.map(|(id, sent)| (*id, sent.stamp)).collect();
        let id = if is_any { String::new() } else { self.id(&goal) };
        // No goal is older than 1970. Without a time and an ID, actionlib would cancel all goals.
        let message = (!is_any || stamp.0 >= 0).then(|| message::GoalId { stamp: to_time(stamp), id });
        (message, Canceling { code: 0, goals })
    }

    /// Returns the statuses of all accepted goals, in the terms of ROS 2.
    pub fn statuses(&self, now: Instant) -> Vec<Status> {
        let is_listed = |sent: &SentGoal| {
            let is_over = sent.ended.is_some_and(|ended| now.saturating_duration_since(ended) >= LISTED);
            sent.is_known && sent.status != status::REJECTED && !is_over
        };
        let listed = self.goals.iter().filter(|(_, sent)| is_listed(sent));
        let mut all: Vec<_> = listed
            .map(|(goal, sent)| Status { goal: *goal, stamp: sent.stamp, status: status::to_ros2(sent.status) })
            .collect();
        all.sort_by_key(|status| (status.stamp, status.goal));
        all.truncate(cdr::MAX_GOALS);
        all
    }

    /// Removes goals that ended [`LINGER`] ago.
    pub fn sweep(&mut self, now: Instant) {
        let is_over = |sent: &SentGoal| sent.ended.is_some_and(|ended| now.saturating_duration_since(ended) >= LINGER);
        let over: Vec<GoalId> = self.goals.iter().filter(|(_, sent)| is_over(sent)).map(|(goal, _)| *goal).collect();
        over.iter().for_each(|goal| self.remove(goal));
    }

    fn remove(&mut self, goal: &GoalId) {
        if let Some(SentGoal { outcome: Some(GoalOutcome::Result(_, result)), .. }) = self.goals.remove(goal) {
            self.result_bytes -= result.len();
        }
    }
}

/// Times before 1970 have no form in ROS 1.
fn to_time((seconds, nanoseconds): Stamp) -> Time {
    seconds.try_into().map_or((0, 0), |seconds| (seconds, nanoseconds))
}

#[cfg(test)]
#[path = "../../tests/unit/actionlib/client.rs"]
mod tests;
