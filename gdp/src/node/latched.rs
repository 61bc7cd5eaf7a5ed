//! The last messages of a name, kept for readers that come later: sent to them again as new messages, which say what they were.

use std::collections::VecDeque;

use gdp_wire::Name;

use crate::seal::{Draft, Encoding, Latched, MessageId};

pub struct LatchedSamples {
    most: usize,
    samples: VecDeque<Sample>,
    /// Sequences of those that are to be sent again: from, and through.
    again: Option<(u64, u64)>,
}

pub struct Sample {
    first: Latched,
    encoding: Encoding,
    in_reply_to: Option<MessageId>,
    origin: Vec<u8>,
    service: Option<Name>,
    body: Vec<u8>,
}

impl Sample {
    pub fn draft(&self) -> Draft<'_> {
        let Self { first, encoding, in_reply_to, origin, service, body } = self;
        let (encoding, in_reply_to, service) = (*encoding, *in_reply_to, *service);
        Draft { encoding, in_reply_to, origin, latched: Some(*first), service, body }
    }
}

impl LatchedSamples {
    pub fn new(most: usize) -> Self {
        Self { most, samples: VecDeque::new(), again: None }
    }

    /// Keeps messages that are sent now, the first of them with this sequence.
    pub fn keep(&mut self, first: u64, timestamp_ns: u64, drafts: &[Draft<'_>]) {
        for (sequence, draft) in (first..).zip(drafts).skip(drafts.len().saturating_sub(self.most)) {
            if self.samples.len() >= self.most {
                self.samples.pop_front();
            }
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

    /// All are to be sent again.
    pub fn again(&mut self) {
        let ends = self.samples.front().zip(self.samples.back());
        self.again = ends.map(|(first, last)| (first.first.sequence, last.first.sequence));
    }

    pub fn has_again(&self) -> bool {
        self.again.is_some()
    }

    /// The next that is to be sent again, once.
    pub fn next_again(&mut self) -> Option<&Sample> {
        let (from, through) = self.again.take()?;
        let at = self.samples.partition_point(|sample| sample.first.sequence < from);
        let sample = self.samples.get(at).filter(|sample| sample.first.sequence <= through)?;
        self.again = Some((sample.first.sequence + 1, through));
        Some(sample)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_are_kept_and_sent_again_once_each() {
        let mut samples = LatchedSamples::new(3);
        let body = [0, 1, 2, 3, 4, 5];
        let drafts: Vec<_> = body.chunks(1).map(|body| Draft::new(Encoding::Bytes, body)).collect();
        samples.keep(10, 77, &drafts[..2]);
        samples.keep(12, 78, &drafts[2..]);
        assert!(samples.next_again().is_none());
        samples.again();
        let mut sent = Vec::new();
        while let Some(sample) = samples.next_again() {
            let draft = sample.draft();
            sent.push((draft.latched.unwrap().sequence, draft.body[0]));
            // What is sent meanwhile reaches all readers as it is.
            if sent.len() == 1 {
                samples.keep(20, 79, &drafts[..2]);
            }
        }
        assert_eq!(sent, [(13, 3), (15, 5)], "one gave way to newer ones");
        let mut none = LatchedSamples::new(0);
        none.keep(1, 1, &drafts);
        none.again();
        assert!(none.next_again().is_none() && none.samples.is_empty());
    }
}
