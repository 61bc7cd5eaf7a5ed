//! How a batch of messages is divided into segments: small messages together in bundles, others
//! alone, in one segment or several. Only arithmetic.

use super::merkle;
use super::message::{Draft, MAX_ORIGIN, TIMESTAMP_LEN};
use super::seal_error::SealError;
use super::wire::{self, OVERHEAD, proof_len};

/// What one leaf of the signed tree covers: a message, or the messages of a bundle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unit {
    /// Number of messages. More than one are a bundle.
    pub messages: usize,
    /// Number of segments of the message, 1 for a bundle.
    pub segments: u32,
    /// Plaintext bytes of a segment, without the proof.
    pub size: u32,
}

/// Replaces `units` by those of a batch, for frame payloads of at most `max_payload` bytes.
pub fn plan(messages: &[Draft<'_>], max_payload: usize, units: &mut Vec<Unit>) -> Result<(), SealError> {
    if let Some(message) = messages.iter().find(|message| message.origin.len() > MAX_ORIGIN) {
        return Err(SealError::OriginTooLong(message.origin.len()));
    }
    // The proof grows with the number of units, and that number with the length of the proof.
    let mut depth = 0;
    loop {
        divide(messages, max_payload, depth, units)?;
        let needed = merkle::depth(units.len());
        if needed <= depth {
            return Ok(());
        }
        depth = needed;
    }
}

fn divide(messages: &[Draft<'_>], max_payload: usize, depth: usize, units: &mut Vec<Unit>) -> Result<(), SealError> {
    units.clear();
    let (capacity, room) = Cut::room(max_payload, depth)?;
    // Plaintext bytes of the last unit as a bundle, if another message may join it.
    let mut open = None;
    for message in messages {
        let len = message.bundled_len();
        if let (Some(used), Some(len), Some(unit)) = (open, len, units.last_mut())
            && used + len <= room
        {
            (unit.messages, unit.size) = (unit.messages + 1, (used + len) as u32);
            open = Some(used + len);
            continue;
        }
        let Cut { count, size } = Cut::new(message.body.len(), message.preamble_len(), capacity, room)?;
        units.push(Unit { messages: 1, segments: count, size });
        open = len.map(|len| TIMESTAMP_LEN + len);
    }
    Ok(())
}

/// The division of a message into segments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cut {
    pub count: u32,
    pub size: u32,
}

impl Cut {
    /// Returns the plaintext bytes of a segment without and with a proof.
    pub fn room(max_payload: usize, depth: usize) -> Result<(usize, usize), SealError> {
        let need = OVERHEAD + proof_len(depth);
        if max_payload < need {
            return Err(SealError::PayloadTooSmall { max_payload, need });
        }
        let capacity = (max_payload - OVERHEAD).min(wire::MAX_PLAINTEXT);
        Ok((capacity, capacity - proof_len(depth)))
    }

    /// Cuts a message for segments of `capacity` bytes, of which the last has `room` beside the
    /// proof.
    pub fn new(body_len: usize, preamble_len: usize, capacity: usize, room: usize) -> Result<Self, SealError> {
        let too_large = SealError::MessageTooLarge { len: body_len, size: capacity };
        let len = body_len.checked_add(preamble_len).ok_or(too_large)?;
        let (full, rest) = (len / capacity, len % capacity);
        // An end that leaves no room for the proof is a segment of its own, before an empty last
        // one.
        let count = full + if rest <= room { 1 } else { 2 };
        let count = u32::try_from(count).map_err(|_| too_large)?;
        Ok(Self { count, size: capacity.min(len) as u32 })
    }
}

#[cfg(test)]
#[path = "../../tests/unit/seal/plan.rs"]
mod tests;
