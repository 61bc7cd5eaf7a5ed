//! Reads and writes the messages that all actions share (`action_msgs`, `unique_identifier_msgs`).
//! It reads CDR of both byte orders with the encapsulation header.

use byteorder::{BigEndian, LittleEndian};
use bytes::Bytes;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::GoalId;

/// `STATUS_ABORTED` of `action_msgs/msg/GoalStatus`.
pub const ABORTED: i8 = 6;

/// `STATUS_UNKNOWN` of `action_msgs/msg/GoalStatus`.
pub const UNKNOWN: i8 = 0;

/// The goal ID in a cancel request that stands for any goal.
pub const ANY_GOAL: GoalId = [0; 16];

/// Maximum number of elements in a list. Longer lists are refused.
pub const MAX_GOALS: usize = 4096;

/// `builtin_interfaces/msg/Time`: seconds and nanoseconds.
pub type Stamp = (i32, u32);

/// The error for bytes that are not the expected message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("not a message that an action has there")]
pub struct Malformed;

/// One element of `action_msgs/msg/GoalStatusArray`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
    pub goal: GoalId,
    /// The time of acceptance, on the server's clock.
    pub stamp: Stamp,
    pub status: i8,
}

impl Status {
    /// Returns whether the goal succeeded, was canceled or was aborted.
    pub fn is_final(&self) -> bool {
        (4..=6).contains(&self.status)
    }
}

/// `action_msgs/srv/CancelGoal_Response`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Canceling {
    pub code: i8,
    /// The goals that are being canceled, with their stamps.
    pub goals: Vec<(GoalId, Stamp)>,
}

/// Reads the goal ID at the start of a message. The message is feedback, or a request of
/// `send_goal`, `cancel_goal` or `get_result`.
pub fn goal_of(message: &[u8]) -> Result<GoalId, Malformed> {
    read(message)
}

/// Writes a request of `get_result`.
pub fn result_request(goal: &GoalId) -> Bytes {
    write(goal)
}

/// Writes a request of `cancel_goal` for a goal, or for [`ANY_GOAL`].
pub fn cancel_request(goal: &GoalId) -> Bytes {
    write(&(*goal, Stamp::default()))
}

/// Reads a request of `cancel_goal`: a goal, and the time up to which goals are canceled.
pub fn cancel_of(request: &[u8]) -> Result<(GoalId, Stamp), Malformed> {
    read(request)
}

/// Returns whether a response of `send_goal` accepts the goal.
pub fn is_accepted(response: &[u8]) -> Result<bool, Malformed> {
    Ok(read::<u8>(response)? != 0)
}

/// Reads the status at the start of a response of `get_result`.
pub fn result_status(response: &[u8]) -> Result<i8, Malformed> {
    read(response)
}

/// Reads an `action_msgs/msg/GoalStatusArray`.
pub fn statuses(message: &[u8]) -> Result<Vec<Status>, Malformed> {
    let statuses = read::<Vec<Status>>(message)?;
    check_count(&statuses)?;
    Ok(statuses)
}

/// Writes an `action_msgs/msg/GoalStatusArray`.
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

    /// Writes a response of `cancel_goal`.
    pub fn write(&self) -> Bytes {
        write(self)
    }

    /// Merges the responses of several servers to one request. The result is a success if any
    /// response is. Returns `None` without responses.
    pub fn merge(answers: impl IntoIterator<Item = Self>) -> Option<Self> {
        answers.into_iter().reduce(|mut all, one| {
            all.code = if all.code == 0 || one.code == 0 { 0 } else { all.code };
            all.goals.extend(one.goals);
            all.goals.truncate(MAX_GOALS);
            all
        })
    }
}

/// Returns a response of `send_goal` that rejects the goal.
pub fn rejected() -> Bytes {
    write(&(false, Stamp::default()))
}

/// Returns a response of `send_goal` that accepts the goal.
pub fn accepted(stamp: Stamp) -> Bytes {
    write(&(true, stamp))
}

/// Returns a response of `cancel_goal` that rejects the request.
pub fn not_canceling() -> Bytes {
    const REJECTED: i8 = 1;
    Canceling { code: REJECTED, goals: vec![] }.write()
}

/// Returns a response of `get_result` for an aborted goal, of 4096 bytes with the status. The rest
/// is zeros, because the result's type depends on the action. Readers decode zero numbers and empty
/// strings and lists; a result of more bytes does not decode.
pub fn aborted() -> Bytes {
    without_result(ABORTED)
}

/// Returns a response of `get_result` for an unknown goal, as [`aborted`].
pub fn unknown() -> Bytes {
    without_result(UNKNOWN)
}

fn without_result(status: i8) -> Bytes {
    const RESULT: usize = 4096;
    let mut message = write(&status).to_vec();
    message.resize(size_of::<[u8; 4]>() + RESULT, 0);
    message.into()
}

/// Reads a value from the start of a message, and ignores the rest.
fn read<T: DeserializeOwned>(message: &[u8]) -> Result<T, Malformed> {
    let value = match message.split_first_chunk() {
        Some(([0, 0, _, _], body)) => cdr_encoding::from_bytes::<T, BigEndian>(body),
        Some(([0, 1, _, _], body)) => cdr_encoding::from_bytes::<T, LittleEndian>(body),
        _ => return Err(Malformed),
    };
    value.map(|(value, _)| value).map_err(|_| Malformed)
}

/// Writes a message in little-endian CDR, padded to a multiple of four bytes.
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
