//! What is kept of a name for readers that come later: a message about the name itself, if there is
//! one, and the last ones of each origin. They are sent to such readers as new messages; the latter
//! say what they were.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

use gdp_wire::Name;

use gdp_e2e::seal::{Draft, Encoding, Latched, MessageId};

/// Origins that are kept apart. Beyond, the messages that are oldest go.
const MAX_ORIGINS: usize = 1024;

pub struct LatchedSamples {
    /// Of each origin of which nothing else was said.
    most: usize,
    /// Of origins of which it was.
    most_of: HashMap<Vec<u8>, usize>,
    pinned: Option<About>,
    /// What is to be sent next about the name, and what was taken of it.
    next: Option<About>,
    taken: Option<About>,
    samples: VecDeque<Sample>,
    /// How many there are of each origin.
    counts: HashMap<Vec<u8>, usize>,
    /// Sequences of those that are to be sent again: from, and through.
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

    /// Keeps a message about the name, in place of the one before. It is to be sent now, too.
    pub fn pin(&mut self, encoding: Encoding, body: &[u8]) {
        self.pinned = Some(About { encoding, body: body.into() });
        self.next = self.pinned.clone();
    }

    /// A message about the name is to be sent now, unless one is to be already; readers that come
    /// later do not get it.
    pub fn mention(&mut self, encoding: Encoding, body: &[u8]) {
        self.next.get_or_insert_with(|| About { encoding, body: body.into() });
    }

    /// Of this origin so many are kept from now on.
    pub fn limit(&mut self, origin: &[u8], most: usize) {
        self.most_of.insert(origin.to_vec(), most);
        while self.counts.get(origin).is_some_and(|count| *count > most) {
            self.remove_oldest(origin);
        }
    }

    /// Keeps messages that are sent now, the first of them with this sequence.
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

    /// Keeps nothing of this origin any more, and knows nothing of it.
    pub fn forget(&mut self, origin: &[u8]) {
        self.most_of.remove(origin);
        if self.counts.remove(origin).is_some() {
            self.samples.retain(|sample| sample.origin != origin);
        }
    }

    /// All are to be sent again.
    pub fn again(&mut self) {
        self.next = self.pinned.clone().or(self.next.take());
        let ends = self.samples.front().zip(self.samples.back());
        self.again = ends.map(|(first, last)| (first.first.sequence, last.first.sequence));
    }

    pub fn has_again(&self) -> bool {
        self.next.is_some() || self.again.is_some()
    }

    /// The next that is to be sent again, once: first what is about the name.
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
