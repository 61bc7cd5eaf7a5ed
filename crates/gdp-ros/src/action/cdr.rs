//! The messages that are the same for all actions (`action_msgs`, `unique_identifier_msgs`), in CDR
//! of either byte order with its encapsulation.

use byteorder::{BigEndian, LittleEndian};
use bytes::Bytes;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::GoalId;

/// Of `action_msgs/msg/GoalStatus`.
pub const ABORTED: i8 = 6;

/// Of `action_msgs/msg/GoalStatus`: nobody knows the goal.
pub const UNKNOWN: i8 = 0;

/// The id in a request that cancels which means any goal.
pub const ANY_GOAL: GoalId = [0; 16];

/// Elements of a list; more are refused.
pub const MAX_GOALS: usize = 4096;

/// `builtin_interfaces/msg/Time`: seconds and nanoseconds.
pub type Stamp = (i32, u32);

/// Bytes that are no such message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("not a message that an action has there")]
pub struct Malformed;

/// One element of `action_msgs/msg/GoalStatusArray`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
    pub goal: GoalId,
    /// When it was accepted, on the server's clock.
    pub stamp: Stamp,
    pub status: i8,
}

impl Status {
    /// Whether the goal has ended, well or not.
    pub fn is_final(&self) -> bool {
        (4..=6).contains(&self.status)
    }
}

/// `action_msgs/srv/CancelGoal_Response`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Canceling {
    pub code: i8,
    /// With the stamps.
    pub goals: Vec<(GoalId, Stamp)>,
}

/// The goal that a message begins with: one of feedback, or a request that sends, cancels or asks
/// for the result.
pub fn goal_of(message: &[u8]) -> Result<GoalId, Malformed> {
    read(message)
}

/// Whether a response of `send_goal` says that the goal is accepted.
pub fn is_accepted(response: &[u8]) -> Result<bool, Malformed> {
    Ok(read::<u8>(response)? != 0)
}

/// The status that a response of `get_result` begins with.
pub fn result_status(response: &[u8]) -> Result<i8, Malformed> {
    read(response)
}

/// Reads an `action_msgs/msg/GoalStatusArray`.
pub fn statuses(message: &[u8]) -> Result<Vec<Status>, Malformed> {
    let statuses = read::<Vec<Status>>(message)?;
    check_count(&statuses)?;
    Ok(statuses)
}

/// Writes one.
pub fn status_array(statuses: &[Status]) -> Bytes {
    write(&statuses)
}

impl Canceling {
    /// Reads a response of `cancel_goal`.
    pub fn read(response: &[u8]) -> Result<Self, Malformed> {
        let canceling = read::<Self>(response)?;
        check_count(&canceling.goals)?;
        Ok(canceling)
    }

    /// Writes one.
    pub fn write(&self) -> Bytes {
        write(self)
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
    write(&(false, Stamp::default()))
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
    let mut message = write(&ABORTED).to_vec();
    message.resize(size_of::<[u8; 4]>() + RESULT, 0);
    message.into()
}

/// Reads the beginning of a message; what follows is left.
fn read<T: DeserializeOwned>(message: &[u8]) -> Result<T, Malformed> {
    let value = match message.split_first_chunk() {
        Some(([0, 0, _, _], body)) => cdr_encoding::from_bytes::<T, BigEndian>(body),
        Some(([0, 1, _, _], body)) => cdr_encoding::from_bytes::<T, LittleEndian>(body),
        _ => return Err(Malformed),
    };
    value.map(|(value, _)| value).map_err(|_| Malformed)
}

/// Writes a message, little-endian, padded to whole words.
fn write(value: &impl Serialize) -> Bytes {
    let mut message = vec![0, 1, 0, 0];
    cdr_encoding::to_writer::<_, LittleEndian, _>(&mut message, value).expect("memory takes every message");
    message.resize(message.len().next_multiple_of(4), 0);
    message.into()
}

fn check_count<T>(list: &[T]) -> Result<(), Malformed> {
    if list.len() > MAX_GOALS { Err(Malformed) } else { Ok(()) }
}

#[cfg(test)]
#[path = "../../tests/unit/action/cdr.rs"]
mod tests;
