//! Small messages that came one upon another and are not sealed yet: they will share a signature, and frames.

use crate::seal::{Draft, Encoding};

/// Since the last time a topic sealed. A message that comes later than that is sealed by itself, at once; one that comes sooner
/// waits as long, for company.
pub const GATHERING: u64 = 100_000;

/// With how many it is not worth while to wait: more share a signature that costs each of them little by then, but their proofs grow.
const MOST: usize = 64;
const MOST_BYTES: usize = 64 << 10;

/// A larger one fills frames of its own.
const SMALL: usize = 16 << 10;

pub struct Gathered {
    most: usize,
    bodies: Vec<u8>,
    /// Encodings, and where in `bodies` each ends.
    ends: Vec<(Encoding, usize)>,
}

impl Gathered {
    /// For a reliable topic that keeps so many messages, or another: a good part of a history is not to go at once.
    pub fn new(history: Option<usize>) -> Self {
        let most = history.map_or(MOST, |history| (history / 4).clamp(1, MOST));
        Self { most, bodies: Vec::new(), ends: Vec::new() }
    }

    /// Whether these can wait here: one, small and without extensions, so that sealing it cannot fail for what it is.
    pub fn takes(drafts: &[Draft<'_>]) -> bool {
        let is_plain = |draft: &Draft<'_>| {
            draft.origin.is_empty() && draft.in_reply_to.is_none() && draft.latched.is_none() && draft.service.is_none()
        };
        matches!(drafts, [only] if only.body.len() <= SMALL && is_plain(only))
    }

    pub fn push(&mut self, draft: &Draft<'_>) {
        self.bodies.extend_from_slice(draft.body);
        self.ends.push((draft.encoding, self.bodies.len()));
    }

    pub fn len(&self) -> usize {
        self.ends.len()
    }

    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    pub fn is_full(&self) -> bool {
        self.ends.len() >= self.most || self.bodies.len() >= MOST_BYTES
    }

    pub fn drafts(&self) -> Vec<Draft<'_>> {
        let starts = std::iter::once(0).chain(self.ends.iter().map(|(_, end)| *end));
        let place =
            |((encoding, end), start): (&(Encoding, usize), usize)| Draft::new(*encoding, &self.bodies[start..*end]);
        self.ends.iter().zip(starts).map(place).collect()
    }

    /// Keeps the capacity.
    pub fn clear(&mut self) {
        self.bodies.clear();
        self.ends.clear();
    }
}
