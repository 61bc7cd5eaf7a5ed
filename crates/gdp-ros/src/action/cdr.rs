//! The messages that are the same for all actions (`action_msgs`, `unique_identifier_msgs`), in CDR
//! of either byte order with its encapsulation.

use bytes::Bytes;

use super::GoalId;

/// Of `action_msgs/msg/GoalStatus`.
pub const ABORTED: i8 = 6;

/// Of `action_msgs/msg/GoalStatus`: nobody knows the goal.
pub const UNKNOWN: i8 = 0;

/// The id in a request that cancels which means any goal.
pub const ANY_GOAL: GoalId = [0; 16];

/// Elements of a list; more are refused.
pub const MAX_GOALS: usize = 4096;

/// Bytes that are no such message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("not a message that an action has there")]
pub struct Malformed;

/// One element of `action_msgs/msg/GoalStatusArray`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status {
    pub goal: GoalId,
    /// When it was accepted: seconds and nanoseconds, on the server's clock.
    pub stamp: (i32, u32),
    pub status: i8,
}

impl Status {
    /// Whether the goal has ended, well or not.
    pub fn is_final(&self) -> bool {
        (4..=6).contains(&self.status)
    }
}

/// `action_msgs/srv/CancelGoal_Response`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Canceling {
    pub code: i8,
    /// With the stamps.
    pub goals: Vec<(GoalId, (i32, u32))>,
}

/// The goal that a message begins with: one of feedback, or a request that sends, cancels or asks
/// for the result.
pub fn goal_of(message: &[u8]) -> Result<GoalId, Malformed> {
    Reader::new(message)?.goal()
}

/// Whether a response of `send_goal` says that the goal is accepted.
pub fn is_accepted(response: &[u8]) -> Result<bool, Malformed> {
    Ok(Reader::new(response)?.byte()? != 0)
}

/// The status that a response of `get_result` begins with.
pub fn result_status(response: &[u8]) -> Result<i8, Malformed> {
    Ok(Reader::new(response)?.byte()? as i8)
}

/// Reads an `action_msgs/msg/GoalStatusArray`.
pub fn statuses(message: &[u8]) -> Result<Vec<Status>, Malformed> {
    let mut from = Reader::new(message)?;
    let count = from.count()?;
    (0..count)
        .map(|_| {
            let (goal, stamp) = (from.goal()?, from.stamp()?);
            Ok(Status { goal, stamp, status: from.byte()? as i8 })
        })
        .collect()
}

/// Writes one.
pub fn status_array(statuses: &[Status]) -> Bytes {
    let mut to = Writer::new();
    to.word(statuses.len() as u32);
    for Status { goal, stamp, status } in statuses {
        to.0.extend(goal);
        to.stamp(*stamp);
        to.0.push(*status as u8);
    }
    to.finish()
}

impl Canceling {
    /// Reads a response of `cancel_goal`.
    pub fn read(response: &[u8]) -> Result<Self, Malformed> {
        let mut from = Reader::new(response)?;
        let (code, count) = (from.byte()? as i8, from.count()?);
        let goals = (0..count).map(|_| Ok((from.goal()?, from.stamp()?))).collect::<Result<_, _>>()?;
        Ok(Self { code, goals })
    }

    /// Writes one.
    pub fn write(&self) -> Bytes {
        let mut to = Writer::new();
        to.0.push(self.code as u8);
        to.word(self.goals.len() as u32);
        for (goal, stamp) in &self.goals {
            to.0.extend(goal);
            to.stamp(*stamp);
        }
        to.finish()
    }

    /// What several servers answered to one request, as one: it was good if it was good for any of
    /// them.
    pub fn merge(answers: impl IntoIterator<Item = Self>) -> Option<Self> {
        answers.into_iter().reduce(|mut all, one| {
            all.code = if all.code == 0 || one.code == 0 { 0 } else { all.code };
            all.goals.extend(one.goals);
            all.goals.truncate(MAX_GOALS);
            all
        })
    }
}

/// A response of `send_goal`: the goal is not accepted.
pub fn rejected() -> Bytes {
    let mut to = Writer::new();
    to.0.push(0);
    to.stamp((0, 0));
    to.finish()
}

/// A response of `cancel_goal`: it is not done.
pub fn not_canceling() -> Bytes {
    const REJECTED: i8 = 1;
    Canceling { code: REJECTED, goals: vec![] }.write()
}

/// A response of `get_result`: the goal was aborted. The result, whose type is the action's own, is
/// zeros: each number in it reads as zero, and each text and list as empty, as far as they reach.
pub fn aborted() -> Bytes {
    const RESULT: usize = 4096;
    let mut to = Writer::new();
    to.0.push(ABORTED as u8);
    to.0.resize(RESULT, 0);
    to.finish()
}

struct Reader<'a> {
    /// Without the encapsulation.
    body: &'a [u8],
    at: usize,
    big_endian: bool,
}

impl<'a> Reader<'a> {
    fn new(message: &'a [u8]) -> Result<Self, Malformed> {
        match message.split_first_chunk() {
            Some(([0, order @ (0 | 1), _, _], body)) => Ok(Self { body, at: 0, big_endian: *order == 0 }),
            _ => Err(Malformed),
        }
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], Malformed> {
        let bytes = self.body.get(self.at..).and_then(|rest| rest.first_chunk()).ok_or(Malformed)?;
        self.at += N;
        Ok(*bytes)
    }

    fn byte(&mut self) -> Result<u8, Malformed> {
        self.take().map(|[byte]| byte)
    }

    fn goal(&mut self) -> Result<GoalId, Malformed> {
        self.take()
    }

    fn word(&mut self) -> Result<u32, Malformed> {
        self.at = self.at.next_multiple_of(4);
        let bytes = self.take()?;
        Ok(if self.big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) })
    }

    fn count(&mut self) -> Result<usize, Malformed> {
        let count = self.word()? as usize;
        if count > MAX_GOALS { Err(Malformed) } else { Ok(count) }
    }

    fn stamp(&mut self) -> Result<(i32, u32), Malformed> {
        Ok((self.word()? as i32, self.word()?))
    }
}

/// Little-endian, without the encapsulation.
struct Writer(Vec<u8>);

impl Writer {
    fn new() -> Self {
        Self(Vec::new())
    }

    fn word(&mut self, word: u32) {
        self.0.resize(self.0.len().next_multiple_of(4), 0);
        self.0.extend(word.to_le_bytes());
    }

    fn stamp(&mut self, (seconds, nanoseconds): (i32, u32)) {
        self.word(seconds as u32);
        self.word(nanoseconds);
    }

    fn finish(mut self) -> Bytes {
        self.0.resize(self.0.len().next_multiple_of(4), 0);
        [&[0, 1, 0, 0][..], &self.0].concat().into()
    }
}

#[cfg(test)]
#[path = "../../tests/unit/action/cdr.rs"]
mod tests;
