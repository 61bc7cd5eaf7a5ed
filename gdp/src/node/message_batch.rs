//! Batches of small unsealed messages that follow one another closely. The messages of a batch
//! share a signature and frames.

use std::sync::atomic::{AtomicU64, Ordering};

use gdp_e2e::seal::{Draft, Encoding, MAX_ORIGIN};

/// Batching window after a topic's last seal, in nanoseconds. A later message is sealed alone and
/// at once, unless it has to wait for a turn. An earlier message waits this long for others.
pub const BATCH_WINDOW: u64 = 100_000;

/// Limits of the signing rate of a node, in nanoseconds. Small messages of all topics are signed
/// `APART` apart, because each signature costs every reader the time of many messages. A burst may
/// use the turns of `TOGETHER` at once. No message waits longer than `LONGEST` for its turn.
const APART: u64 = 300_000;
const TOGETHER: u64 = 16 * APART;
const LONGEST: u64 = 8_000_000;

/// Allocates turns to sign. Topics with more messages than turns share signatures: each batches its
/// messages until its turn. A message without likely company until its turn does not wait.
#[derive(Default)]
pub struct Turns(AtomicU64);

impl Turns {
    /// Takes the next turn and returns its time, in nanoseconds of the node's clock.
    pub fn take(&self, now: u64) -> u64 {
        let next = |last: u64| (last.max(now) + APART).min(now + LONGEST + TOGETHER);
        let (Ok(last) | Err(last)) = self.0.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |last| Some(next(last)));
        (next(last) - APART).saturating_sub(TOGETHER).max(now)
    }
}

/// Maximum size of a batch. Beyond it, a shared signature saves little per message, but the proofs
/// grow.
const MOST: usize = 64;
const MOST_BYTES: usize = 64 << 10;

/// Maximum body of a batched message. A larger message fills frames of its own.
const SMALL: usize = 16 << 10;

pub struct MessageBatch {
    most: usize,
    /// The concatenated origins and bodies.
    bytes: Vec<u8>,
    parts: Vec<Part>,
}

struct Part {
    encoding: Encoding,
    /// End offsets of the origin and the body.
    ends: (usize, usize),
}

impl MessageBatch {
    /// Creates an empty batch. For a reliable topic, the size of its history limits the batch: a
    /// large part of a history must not leave at once.
    pub fn new(history: Option<usize>) -> Self {
        let most = history.map_or(MOST, |history| (history / 4).clamp(1, MOST));
        Self { most, bytes: Vec::new(), parts: Vec::new() }
    }

    /// Returns whether these drafts can wait in a batch: one small draft without extensions other
    /// than a valid origin. Sealing such a draft cannot fail because of its contents.
    pub fn takes(drafts: &[Draft<'_>]) -> bool {
        let is_plain = |draft: &Draft<'_>| {
            let Draft { origin, in_reply_to, latched, service, .. } = draft;
            origin.len() <= MAX_ORIGIN && in_reply_to.is_none() && latched.is_none() && service.is_none()
        };
        matches!(drafts, [only] if only.body.len() <= SMALL && is_plain(only))
    }

    pub fn push(&mut self, draft: &Draft<'_>) {
        self.bytes.extend_from_slice(draft.origin);
        let origin = self.bytes.len();
        self.bytes.extend_from_slice(draft.body);
        self.parts.push(Part { encoding: draft.encoding, ends: (origin, self.bytes.len()) });
    }

    pub fn len(&self) -> usize {
        self.parts.len()
    }

    pub fn is_empty(&self) -> bool {
        self.parts.is_empty()
    }

    pub fn is_full(&self) -> bool {
        self.parts.len() >= self.most || self.bytes.len() >= MOST_BYTES
    }

    pub fn drafts(&self) -> Vec<Draft<'_>> {
        let starts = std::iter::once(0).chain(self.parts.iter().map(|part| part.ends.1));
        let draft = |(part, start): (&Part, usize)| {
            let (origin, body) = part.ends;
            Draft { origin: &self.bytes[start..origin], ..Draft::new(part.encoding, &self.bytes[origin..body]) }
        };
        self.parts.iter().zip(starts).map(draft).collect()
    }

    /// Removes all messages but retains the capacity.
    pub fn clear(&mut self) {
        self.bytes.clear();
        self.parts.clear();
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/message_batch.rs"]
mod tests;
