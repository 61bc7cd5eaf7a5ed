//! Small messages that came one upon another and are not sealed yet: they will share a signature,
//! and frames.

use std::sync::atomic::{AtomicU64, Ordering};

use gdp_e2e::seal::{Draft, Encoding, MAX_ORIGIN};

/// Since the last time a topic sealed. A message that comes later than that is sealed by itself, at
/// once, if there is nothing to wait for; one that comes sooner waits as long, for company.
pub const BATCH_WINDOW: u64 = 100_000;

/// Small messages of all topics of a node together are signed so much apart, because each costs
/// every reader the time of many messages; so many may come upon one another; and none waits longer
/// for its turn.
const APART: u64 = 300_000;
const TOGETHER: u64 = 16 * APART;
const LONGEST: u64 = 8_000_000;

/// Whose turn it is to sign. Topics that together have more messages than that share signatures
/// out: each gathers what comes until its turn. What comes too seldom to meet company by then does
/// not wait.
#[derive(Default)]
pub struct Turns(AtomicU64);

impl Turns {
    /// Takes the next turn; when it is. Clock in nanoseconds, as all times here.
    pub fn take(&self, now: u64) -> u64 {
        let next = |last: u64| (last.max(now) + APART).min(now + LONGEST + TOGETHER);
        let (Ok(last) | Err(last)) = self.0.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |last| Some(next(last)));
        (next(last) - APART).saturating_sub(TOGETHER).max(now)
    }
}

/// With how many it is not worth while to wait: more share a signature that costs each of them
/// little by then, but their proofs grow.
const MOST: usize = 64;
const MOST_BYTES: usize = 64 << 10;

/// A larger one fills frames of its own.
const SMALL: usize = 16 << 10;

pub struct MessageBatch {
    most: usize,
    /// Origin and body of one after another.
    bytes: Vec<u8>,
    parts: Vec<Part>,
}

struct Part {
    encoding: Encoding,
    /// Where in the bytes its origin ends, and its body.
    ends: (usize, usize),
}

impl MessageBatch {
    /// For a reliable topic that keeps so many messages, or another: a good part of a history is
    /// not to go at once.
    pub fn new(history: Option<usize>) -> Self {
        let most = history.map_or(MOST, |history| (history / 4).clamp(1, MOST));
        Self { most, bytes: Vec::new(), parts: Vec::new() }
    }

    /// Whether these can wait here: one, small and with no extension but a good origin, so that
    /// sealing it cannot fail for what it is.
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

    /// Keeps the capacity.
    pub fn clear(&mut self) {
        self.bytes.clear();
        self.parts.clear();
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/message_batch.rs"]
mod tests;
