//! The reader's state of a message: received and requested segments.

use crate::feedback_wire::Missing;

/// Bytes of state per message, without its bits.
const FIXED: usize = size_of::<Slot<()>>();

/// Number of requests at the normal interval. The interval doubles with every further unanswered
/// request.
const PROMPT_TRIES: u32 = 3;

#[derive(Debug)]
pub enum Body<M> {
    /// Not complete.
    Open,
    /// Complete, and waiting for earlier messages.
    Complete(M, usize),
}

/// The state of a message. `M` is the message as delivered.
#[derive(Debug)]
pub struct Slot<M> {
    pub body: Body<M>,
    pub cut: u16,
    /// Time of the first sign of the message.
    pub known_at: u64,
    /// Number of segments; 0: none received.
    total: u32,
    missing: u32,
    received: Bits,
    asked: Bits,
    /// Time of the first request since the requests were last reset.
    asked_at: Option<u64>,
    tries: u32,
}

impl<M> Slot<M> {
    pub fn new(now: u64) -> Self {
        Self {
            body: Body::Open,
            cut: 0,
            known_at: now,
            total: 0,
            missing: 0,
            received: Bits::default(),
            asked: Bits::default(),
            asked_at: None,
            tries: 0,
        }
    }

    /// Returns the memory cost in bytes of a message of `total` segments.
    pub fn cost(total: u32) -> usize {
        FIXED + 2 * (total as usize).div_ceil(8)
    }

    pub fn total(&self) -> u32 {
        self.total
    }

    pub fn is_open(&self) -> bool {
        matches!(self.body, Body::Open)
    }

    /// Records a segment. Returns false if the segment was already received.
    pub fn add(&mut self, cut: u16, index: u32, total: u32) -> bool {
        if self.total == 0 || cut > self.cut {
            self.restart(cut, total);
        }
        if cut != self.cut || index >= self.total || self.received.get(index) {
            return false;
        }
        self.received.set(index, self.total);
        self.missing -= 1;
        true
    }

    /// Discards all received segments.
    pub fn clear(&mut self) {
        self.restart(0, 0);
        (self.asked_at, self.tries) = (None, 0);
    }

    /// Returns the time of the next repeated request, or `None` if nothing was requested.
    pub fn ask_again_at(&self, wait: u64, slowest: u64) -> Option<u64> {
        let wait = (wait << self.tries.saturating_sub(PROMPT_TRIES).min(6)).min(slowest.max(wait));
        self.asked_at.map(|at| at + wait)
    }

    pub fn forget_asked(&mut self) {
        self.asked_at = None;
        self.asked.clear();
    }

    /// Returns whether segments before `end` are missing and not requested.
    pub fn has_wanted(&self, end: u32) -> bool {
        if self.total == 0 {
            return self.asked_at.is_none();
        }
        self.missing > 0 && self.wanted(0, end).is_some()
    }

    /// Appends ranges of segments before `end` that are missing and not requested, up to `most`
    /// ranges in total.
    pub fn ask(&mut self, now: u64, sequence: u64, end: u32, most: usize, out: &mut Vec<Missing>) {
        let before = out.len();
        if self.total == 0 {
            if self.asked_at.is_none() && out.len() < most {
                out.push(Missing::whole(sequence));
            }
        } else if self.missing > 0 {
            let mut from = 0;
            while out.len() < most {
                let Some(first) = self.wanted(from, end) else { break };
                let mut count = 0;
                while first + count < end.min(self.total)
                    && !self.received.get(first + count)
                    && !self.asked.get(first + count)
                {
                    self.asked.set(first + count, self.total);
                    count += 1;
                }
                out.push(Missing { sequence, cut: self.cut, first, count });
                from = first + count;
            }
        }
        if out.len() > before && self.asked_at.is_none() {
            self.asked_at = Some(now);
            self.tries += 1;
        }
    }

    /// Returns the age of the request for this segment, if it was requested once.
    pub fn answered_in(&self, now: u64, index: u32) -> Option<u64> {
        let asked = self.tries == 1 && (self.total == 0 || self.asked.get(index));
        self.asked_at.filter(|_| asked).map(|at| now - at)
    }

    fn restart(&mut self, cut: u16, total: u32) {
        (self.cut, self.total, self.missing) = (cut, total, total);
        self.received.clear();
        self.asked.clear();
    }

    /// Returns the first segment from `from` to `end` that is missing and not requested.
    fn wanted(&self, from: u32, end: u32) -> Option<u32> {
        let end = end.min(self.total);
        let mut index = from;
        while index < end {
            let open = !(self.received.word(index) | self.asked.word(index)) >> (index % 64);
            if open == 0 {
                index = (index / 64 + 1) * 64;
                continue;
            }
            index += open.trailing_zeros();
            return (index < end).then_some(index);
        }
        None
    }
}

/// A bitmap without heap memory up to 64 bits.
#[derive(Debug, Default)]
struct Bits {
    first: u64,
    rest: Vec<u64>,
}

impl Bits {
    fn word(&self, index: u32) -> u64 {
        match index / 64 {
            0 => self.first,
            word => self.rest.get(word as usize - 1).copied().unwrap_or(0),
        }
    }

    fn get(&self, index: u32) -> bool {
        self.word(index) >> (index % 64) & 1 == 1
    }

    /// Sets one of `total` bits.
    fn set(&mut self, index: u32, total: u32) {
        match index / 64 {
            0 => self.first |= 1 << index,
            word => {
                if self.rest.is_empty() {
                    self.rest = vec![0; (total as usize).div_ceil(64) - 1];
                }
                self.rest[word as usize - 1] |= 1 << (index % 64);
            }
        }
    }

    fn clear(&mut self) {
        self.first = 0;
        self.rest = Vec::new();
    }
}
