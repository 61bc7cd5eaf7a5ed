//! The latched messages of a name for late-joining readers.
//!
//! They are the pinned message about the name itself, if any, and the last messages of each origin.
//! Late-joining readers receive them as new messages. Those of origins carry their original
//! sequence and time.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

use gdp_wire::Name;

use gdp_e2e::seal::{Draft, Encoding, Latched, MessageId};

/// Maximum number of origins. Beyond it, the oldest messages are removed.
const MAX_ORIGINS: usize = 1024;

pub struct LatchedSamples {
    /// Messages per origin without its own limit.
    most: usize,
    /// Limits of individual origins.
    most_of: HashMap<Vec<u8>, usize>,
    pinned: Option<About>,
    /// The message about the name to send next.
    next: Option<About>,
    taken: Option<About>,
    samples: VecDeque<Sample>,
    /// Number of messages of each origin.
    counts: HashMap<Vec<u8>, usize>,
    /// Sequences to send again: first and last.
    again: Option<(u64, u64)>,
}

#[derive(Clone)]
struct About {
    encoding: Encoding,
    body: Arc<[u8]>,
}

struct Sample {
    first: Latched,
    encoding: Encoding,
    in_reply_to: Option<MessageId>,
    origin: Vec<u8>,
    service: Option<Name>,
    body: Vec<u8>,
}

impl Sample {
    fn draft(&self) -> Draft<'_> {
        let Self { first, encoding, in_reply_to, origin, service, body } = self;
        let (encoding, in_reply_to, service) = (*encoding, *in_reply_to, *service);
        Draft { encoding, in_reply_to, origin, latched: Some(*first), service, body }
    }
}

impl LatchedSamples {
    pub fn new(most: usize) -> Self {
        Self {
            most,
            most_of: HashMap::new(),
            pinned: None,
            next: None,
            taken: None,
            samples: VecDeque::new(),
            counts: HashMap::new(),
            again: None,
        }
    }

    /// Stores a message about the name, in place of the previous one, and schedules it.
    pub fn pin(&mut self, encoding: Encoding, body: &[u8]) {
        self.pinned = Some(About { encoding, body: body.into() });
        self.next = self.pinned.clone();
    }

    /// Schedules a message about the name, unless one is already scheduled. Late-joining readers do
    /// not receive it.
    pub fn mention(&mut self, encoding: Encoding, body: &[u8]) {
        self.next.get_or_insert_with(|| About { encoding, body: body.into() });
    }

    /// Sets the limit of this origin.
    pub fn limit(&mut self, origin: &[u8], most: usize) {
        self.most_of.insert(origin.to_vec(), most);
        while self.counts.get(origin).is_some_and(|count| *count > most) {
            self.remove_oldest(origin);
        }
    }

    /// Stores messages that are being sent. The first one has this sequence.
    pub fn keep(&mut self, first: u64, timestamp_ns: u64, drafts: &[Draft<'_>]) {
        for (sequence, draft) in (first..).zip(drafts) {
            let most = self.most_of.get(draft.origin).copied().unwrap_or(self.most);
            if most == 0 {
                continue;
            }
            self.make_room(draft.origin, most);
            *self.counts.entry(draft.origin.to_vec()).or_default() += 1;
            self.samples.push_back(Sample {
                first: Latched { sequence, timestamp_ns },
                encoding: draft.encoding,
                in_reply_to: draft.in_reply_to,
                origin: draft.origin.to_vec(),
                service: draft.service,
                body: draft.body.to_vec(),
            });
        }
    }

    fn make_room(&mut self, origin: &[u8], most: usize) {
        match self.counts.get(origin) {
            Some(count) if *count >= most => self.remove_oldest(origin),
            Some(_) => {}
            None => {
                while self.counts.len() >= MAX_ORIGINS {
                    self.remove(0);
                }
            }
        }
    }

    fn remove_oldest(&mut self, origin: &[u8]) {
        let oldest = self.samples.iter().position(|sample| sample.origin == origin);
        oldest.into_iter().for_each(|at| self.remove(at));
    }

    fn remove(&mut self, at: usize) {
        let Some(sample) = self.samples.remove(at) else { return };
        if let Some(count) = self.counts.get_mut(&sample.origin) {
            *count -= 1;
            if *count == 0 {
                self.counts.remove(&sample.origin);
            }
        }
    }

    /// Removes all messages and the limit of this origin.
    pub fn forget(&mut self, origin: &[u8]) {
        self.most_of.remove(origin);
        if self.counts.remove(origin).is_some() {
            self.samples.retain(|sample| sample.origin != origin);
        }
    }

    /// Schedules all latched messages to be sent again.
    pub fn again(&mut self) {
        self.next = self.pinned.clone().or(self.next.take());
        let ends = self.samples.front().zip(self.samples.back());
        self.again = ends.map(|(first, last)| (first.first.sequence, last.first.sequence));
    }

    pub fn has_again(&self) -> bool {
        self.next.is_some() || self.again.is_some()
    }

    /// Returns the next message to send again, once. The message about the name is first.
    pub fn next_again(&mut self) -> Option<Draft<'_>> {
        self.taken = self.next.take();
        if let Some(About { encoding, body }) = &self.taken {
            return Some(Draft::new(*encoding, body));
        }
        let (from, through) = self.again.take()?;
        let at = self.samples.partition_point(|sample| sample.first.sequence < from);
        let sample = self.samples.get(at).filter(|sample| sample.first.sequence <= through)?;
        self.again = Some((sample.first.sequence + 1, through));
        Some(sample.draft())
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/latched.rs"]
mod tests;
