//! An action server for clients of ROS 1, on behalf of a server elsewhere.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::time::{Duration, Instant};

use bytes::Bytes;

use super::message::{self, GoalStatus, Time};
use super::status;
use crate::action::GoalId;
use crate::action::cdr::{self, ANY_GOAL, Status};
use crate::call::Part;

/// Maximum number of goals. Beyond it, goals are rejected until others have ended.
const MAX_SERVED: usize = 512;

/// Maximum number of cancellations that wait for goals which have not arrived yet.
const MAX_RECALLED: usize = 64;

/// Time for which an ended goal is still listed, and for which a cancellation waits for its goal.
/// It is actionlib's `status_list_timeout`.
const LISTED: Duration = Duration::from_secs(5);

/// Time for which a result waits for the feedback before it.
const WAIT: Duration = Duration::from_secs(1);

/// The goals of local clients.
#[derive(Default)]
pub struct GoalServer {
    /// The goals by their IDs in ROS 1.
    goals: BTreeMap<String, Served>,
    ids: HashMap<GoalId, String>,
    /// Goals that were canceled before they arrived.
    recalled: VecDeque<(String, Instant)>,
    /// The latest stamp up to which goals were canceled.
    canceled_until: Time,
    asks: VecDeque<Ask>,
}

struct Served {
    goal: GoalId,
    stamp: Time,
    status: u8,
    text: String,
    is_accepted: bool,
    /// Whether a client has canceled the goal before it was accepted.
    is_canceled: bool,
    /// Whether the status list of the server elsewhere has shown the end of the goal.
    is_over: bool,
    /// The end of the goal, which waits for the feedback before it.
    waiting: Option<(u8, Bytes, Instant)>,
    ended: Option<Instant>,
}

/// A request to the server elsewhere, in CDR.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ask {
    pub part: Part,
    pub goal: GoalId,
    pub request: Bytes,
}

/// A goal that has ended, to be published on `result`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ended {
    pub status: GoalStatus,
    /// The result in the form that the caller stored; `None` if there is none.
    pub result: Option<Bytes>,
}

/// What becomes of a goal that has arrived.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Taken {
    /// It is to be sent to the server elsewhere; see [`GoalServer::send`].
    New,
    /// It is known already.
    Known,
    Ended(Ended),
}

impl GoalServer {
    /// Takes a goal of a local client. `goal` is a new random ID for it.
    pub fn take_goal(&mut self, id: message::GoalId, goal: GoalId) -> Taken {
        let message::GoalId { stamp, id } = id;
        if self.goals.contains_key(&id) {
            return Taken::Known;
        }
        let recalled = self.recalled.iter().position(|(recalled, _)| *recalled == id);
        let is_before = stamp != Time::default() && stamp <= self.canceled_until;
        let end = |status, text: &str| {
            let status = GoalStatus { goal: message::GoalId { stamp, id: id.clone() }, status, text: text.into() };
            Taken::Ended(Ended { status, result: None })
        };
        if recalled.and_then(|at| self.recalled.remove(at)).is_some() || is_before {
            return end(status::RECALLED, "it was canceled before it arrived");
        }
        if self.goals.len() >= MAX_SERVED {
            let ended = self.goals.iter().filter_map(|(id, served)| Some((served.ended?, id.clone())));
            let Some((_, oldest)) = ended.min() else {
                return end(status::REJECTED, "too many goals are under way");
            };
            self.remove(&oldest);
        }
        let (status, text) = (status::PENDING, String::new());
        let (is_accepted, is_canceled, is_over, waiting, ended) = (false, false, false, None, None);
        self.ids.insert(goal, id.clone());
        self.goals.insert(id, Served { goal, stamp, status, text, is_accepted, is_canceled, is_over, waiting, ended });
        Taken::New
    }

    /// Queues the request that sends a new goal.
    pub fn send(&mut self, goal: GoalId, request: Bytes) {
        self.asks.push_back(Ask { part: Part::SendGoal, goal, request });
    }

    /// Returns the next request to the server elsewhere.
    pub fn next_ask(&mut self) -> Option<Ask> {
        self.asks.pop_front()
    }

    /// Takes the answer to the request that sent a goal.
    pub fn accepted(&mut self, goal: &GoalId) {
        let Some(served) = self.served(goal).filter(|served| !served.is_accepted) else { return };
        served.is_accepted = true;
        let is_canceled = served.is_canceled;
        let request = cdr::result_request(goal);
        self.asks.push_back(Ask { part: Part::GetResult, goal: *goal, request });
        if is_canceled {
            self.ask_to_cancel(*goal);
        }
    }

    /// Ends a goal at once, for example because the server elsewhere rejects it.
    pub fn end(&mut self, now: Instant, goal: &GoalId, status: u8, text: &str) -> Option<Ended> {
        let served = self.served(goal).filter(|served| served.ended.is_none())?;
        text.clone_into(&mut served.text);
        self.finish(now, goal, status, None)
    }

    /// Ends all goals that are under way.
    pub fn end_all(&mut self, now: Instant, status: u8, text: &str) -> Vec<Ended> {
        self.asks.clear();
        let goals: Vec<GoalId> = self.ids.keys().copied().collect();
        goals.iter().filter_map(|goal| self.end(now, goal, status, text)).collect()
    }

    /// Takes the result of a goal. It waits for the end of the goal in a status list, because the
    /// feedback arrives before that.
    pub fn take_result(&mut self, now: Instant, goal: &GoalId, status: i8, result: Bytes) -> Option<Ended> {
        let served = self.served(goal).filter(|served| served.ended.is_none())?;
        let status = status::of_result(status::of_ros2(status));
        served.waiting = Some((status, result, now + WAIT));
        if served.is_over { self.release(now, goal) } else { None }
    }

    /// Takes a status list of ROS 2. Returns the goals that have ended, and whether anything has
    /// changed.
    pub fn take_statuses(&mut self, now: Instant, statuses: &[Status]) -> (Vec<Ended>, bool) {
        let (mut ended, mut has_changed) = (Vec::new(), false);
        for status in statuses {
            let Some(served) = self.served(&status.goal).filter(|served| served.ended.is_none()) else { continue };
            if status.is_final() {
                served.is_over = true;
                ended.extend(self.release(now, &status.goal));
                continue;
            }
            let new = status::of_ros2(status.status);
            // Clients do not accept that a goal becomes pending again, or active after a
            // cancellation.
            if rank(new) > rank(served.status) {
                (served.status, has_changed) = (new, true);
            }
        }
        (ended, has_changed)
    }

    /// Returns the goals whose results have waited long enough.
    pub fn due(&mut self, now: Instant) -> Vec<Ended> {
        let is_due = |served: &&Served| served.waiting.as_ref().is_some_and(|(.., until)| *until <= now);
        let due: Vec<GoalId> = self.goals.values().filter(is_due).map(|served| served.goal).collect();
        due.iter().filter_map(|goal| self.release(now, goal)).collect()
    }

    fn release(&mut self, now: Instant, goal: &GoalId) -> Option<Ended> {
        let (status, result, _) = self.served(goal)?.waiting.take()?;
        self.finish(now, goal, status, Some(result))
    }

    fn finish(&mut self, now: Instant, goal: &GoalId, status: u8, result: Option<Bytes>) -> Option<Ended> {
        let served = self.served(goal)?;
        (served.status, served.ended, served.waiting) = (status, Some(now), None);
        let status = self.status_of(goal)?;
        Some(Ended { status, result })
    }

    /// Takes a message of the topic `cancel`.
    pub fn cancel(&mut self, now: Instant, canceled: message::GoalId) {
        let message::GoalId { stamp, id } = canceled;
        let is_all = id.is_empty() && stamp == Time::default();
        if is_all {
            // The server elsewhere cancels the goals of all clients, as one of ROS 1 does.
            self.ask_to_cancel(ANY_GOAL);
        }
        let mut sent = Vec::new();
        for (known, served) in self.goals.iter_mut().filter(|(_, served)| served.ended.is_none()) {
            let is_before = stamp != Time::default() && served.stamp <= stamp;
            if is_all || *known == id || is_before {
                served.is_canceled = true;
                sent.extend((served.is_accepted && !is_all).then_some(served.goal));
            }
        }
        sent.into_iter().for_each(|goal| self.ask_to_cancel(goal));
        self.canceled_until = self.canceled_until.max(stamp);
        if !id.is_empty() && !self.goals.contains_key(&id) {
            self.recalled.push_back((id, now));
            if self.recalled.len() > MAX_RECALLED {
                self.recalled.pop_front();
            }
        }
    }

    /// Queues a cancellation, unless the same one waits already.
    fn ask_to_cancel(&mut self, goal: GoalId) {
        let ask = Ask { part: Part::CancelGoal, goal, request: cdr::cancel_request(&goal) };
        if !self.asks.contains(&ask) {
            self.asks.push_back(ask);
        }
    }

    /// Returns the list for the topic `status`.
    pub fn list(&self) -> Vec<GoalStatus> {
        self.goals.values().filter_map(|served| self.status_of(&served.goal)).collect()
    }

    /// Returns the status of a goal as clients know it.
    fn status_of(&self, goal: &GoalId) -> Option<GoalStatus> {
        let id = self.ids.get(goal)?;
        let Served { stamp, status, text, .. } = self.goals.get(id)?;
        Some(GoalStatus {
            goal: message::GoalId { stamp: *stamp, id: id.clone() },
            status: *status,
            text: text.clone(),
        })
    }

    /// Returns the status of a goal of local clients that is under way. Feedback about other goals
    /// is not theirs.
    pub fn live(&self, goal: &GoalId) -> Option<GoalStatus> {
        self.status_of(goal).filter(|status| !status::is_final(status.status))
    }

    /// Removes goals that have ended [`LISTED`] ago. Returns whether there were any.
    pub fn sweep(&mut self, now: Instant) -> bool {
        let is_over = |since: Instant| now.saturating_duration_since(since) >= LISTED;
        self.recalled.retain(|(_, since)| !is_over(*since));
        let over = self.goals.iter().filter(|(_, served)| served.ended.is_some_and(is_over));
        let over: Vec<String> = over.map(|(id, _)| id.clone()).collect();
        over.iter().for_each(|id| self.remove(id));
        !over.is_empty()
    }

    fn served(&mut self, goal: &GoalId) -> Option<&mut Served> {
        self.goals.get_mut(self.ids.get(goal)?)
    }

    fn remove(&mut self, id: &str) {
        if let Some(served) = self.goals.remove(id) {
            self.ids.remove(&served.goal);
        }
    }
}

/// The order in which a goal passes through the statuses before its end.
fn rank(status: u8) -> u8 {
    match status {
        status::PENDING => 0,
        status::ACTIVE => 1,
        status::RECALLING | status::PREEMPTING => 2,
        _ => 3,
    }
}

#[cfg(test)]
#[path = "../../tests/unit/actionlib/server.rs"]
mod tests;
