//! Reads and writes what all messages of actions in ROS 1 share: `std_msgs/Header` and
//! `actionlib_msgs`, in ROS 1 serialization. Goals, results and feedback stay bytes.

use bytes::Bytes;

use crate::action::cdr::{MAX_GOALS, Malformed};

/// Maximum length of a goal's ID, in bytes. Clients make it of their node's name and a time.
pub const MAX_ID: usize = 1024;

/// Maximum length of a status text, in bytes. Longer texts are cut.
pub const MAX_TEXT: usize = 1024;

/// A time: seconds and nanoseconds.
pub type Time = (u32, u32);

/// `actionlib_msgs/GoalID`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct GoalId {
    pub stamp: Time,
    pub id: String,
}

/// `actionlib_msgs/GoalStatus`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct GoalStatus {
    pub goal: GoalId,
    pub status: u8,
    pub text: String,
}

/// Reads a goal with its wrapper. The goal shares the memory of `message`.
pub fn read_goal(message: &Bytes) -> Result<(GoalId, Bytes), Malformed> {
    let mut from = Cursor(message.clone());
    from.header()?;
    Ok((from.goal()?, from.0))
}

pub fn write_goal(stamp: Time, goal: &GoalId, body: &[u8]) -> Bytes {
    let mut message = header(stamp);
    put_goal(&mut message, goal);
    message.extend(body);
    message.into()
}

/// Reads a result or feedback with its wrapper. The result or feedback shares the memory of
/// `message`.
pub fn read_update(message: &Bytes) -> Result<(GoalStatus, Bytes), Malformed> {
    let mut from = Cursor(message.clone());
    from.header()?;
    Ok((from.status()?, from.0))
}

/// Writes a result or feedback with its wrapper.
pub fn write_update(stamp: Time, status: &GoalStatus, body: &[u8]) -> Bytes {
    let mut message = header(stamp);
    put_status(&mut message, status);
    message.extend(body);
    message.into()
}

/// Reads a message of the topic `cancel`.
pub fn read_cancel(message: &Bytes) -> Result<GoalId, Malformed> {
    let mut from = Cursor(message.clone());
    let goal = from.goal()?;
    if from.0.is_empty() { Ok(goal) } else { Err(Malformed) }
}

pub fn write_cancel(goal: &GoalId) -> Bytes {
    let mut message = Vec::new();
    put_goal(&mut message, goal);
    message.into()
}

/// Reads `actionlib_msgs/GoalStatusArray`.
pub fn read_statuses(message: &Bytes) -> Result<Vec<GoalStatus>, Malformed> {
    let mut from = Cursor(message.clone());
    from.header()?;
    let count = from.word()? as usize;
    if count > MAX_GOALS {
        return Err(Malformed);
    }
    let statuses = (0..count).map(|_| from.status()).collect::<Result<_, _>>()?;
    if from.0.is_empty() { Ok(statuses) } else { Err(Malformed) }
}

pub fn write_statuses(stamp: Time, statuses: &[GoalStatus]) -> Bytes {
    let mut message = header(stamp);
    message.extend((statuses.len() as u32).to_le_bytes());
    statuses.iter().for_each(|status| put_status(&mut message, status));
    message.into()
}

/// Returns a header without a sequence number and a frame, as actionlib sends it.
fn header(stamp: Time) -> Vec<u8> {
    let mut message = vec![0; 4];
    put_time(&mut message, stamp);
    put_text(&mut message, "");
    message
}

fn put_time(message: &mut Vec<u8>, (seconds, nanoseconds): Time) {
    message.extend(seconds.to_le_bytes());
    message.extend(nanoseconds.to_le_bytes());
}

fn put_text(message: &mut Vec<u8>, text: &str) {
    message.extend((text.len() as u32).to_le_bytes());
    message.extend(text.as_bytes());
}

fn put_goal(message: &mut Vec<u8>, goal: &GoalId) {
    put_time(message, goal.stamp);
    put_text(message, &goal.id);
}

fn put_status(message: &mut Vec<u8>, status: &GoalStatus) {
    put_goal(message, &status.goal);
    message.push(status.status);
    put_text(message, &status.text);
}

/// The bytes that are still to read.
struct Cursor(Bytes);

impl Cursor {
    fn take(&mut self, length: usize) -> Result<Bytes, Malformed> {
        if length > self.0.len() { Err(Malformed) } else { Ok(self.0.split_to(length)) }
    }

    fn word(&mut self) -> Result<u32, Malformed> {
        self.take(4)?[..].try_into().map(u32::from_le_bytes).map_err(|_| Malformed)
    }

    fn text(&mut self) -> Result<Bytes, Malformed> {
        let length = self.word()? as usize;
        self.take(length)
    }

    fn header(&mut self) -> Result<(), Malformed> {
        self.take(3 * 4)?;
        self.text().map(drop)
    }

    fn goal(&mut self) -> Result<GoalId, Malformed> {
        let (stamp, id) = ((self.word()?, self.word()?), self.text()?);
        if id.len() > MAX_ID {
            return Err(Malformed);
        }
        // Clients compare it with theirs, so it must not change.
        let id = str::from_utf8(&id).map_err(|_| Malformed)?.to_owned();
        Ok(GoalId { stamp, id })
    }

    fn status(&mut self) -> Result<GoalStatus, Malformed> {
        let (goal, status, text) = (self.goal()?, self.take(1)?[0], self.text()?);
        let mut text = String::from_utf8_lossy(&text[..text.len().min(MAX_TEXT)]).into_owned();
        // What stands for invalid bytes is longer than they are.
        text.truncate(text.floor_char_boundary(MAX_TEXT));
        Ok(GoalStatus { goal, status, text })
    }
}

#[cfg(test)]
#[path = "../../tests/unit/actionlib/message.rs"]
mod tests;
