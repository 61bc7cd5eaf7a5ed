//! A message that a reader knows of: which of its segments are there, which were asked for.

use crate::feedback_wire::Missing;

/// What is kept per message besides its bits, in bytes.
const FIXED: usize = size_of::<Slot<()>>();

/// What was asked for as often in vain is asked for half as often from then on.
const PROMPT_TRIES: u32 = 3;

#[derive(Debug)]
pub enum Body<M> {
    /// Not complete.
    Open,
    /// Complete, and waits for those before it.
    Complete(M, usize),
}

/// `M`: the message as it is delivered.
#[derive(Debug)]
pub struct Slot<M> {
    pub body: Body<M>,
    pub cut: u16,
    /// When it became known.
    pub known_at: u64,
    /// Segments, the proof included; 0: none has come.
    total: u32,
    missing: u32,
    received: Bits,
    asked: Bits,
    /// Whether anything was asked for since the last time all was to be asked again.
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

    /// Bytes that a message of so many segments costs.
    pub fn cost(total: u32) -> usize {
        FIXED + 2 * (total as usize).div_ceil(8)
    }

    pub fn total(&self) -> u32 {
        self.total
    }

    pub fn is_open(&self) -> bool {
        matches!(self.body, Body::Open)
    }

    /// A segment came. False if it was there.
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

    /// All that came is lost again.
    pub fn clear(&mut self) {
        self.restart(0, 0);
        (self.asked_at, self.tries) = (None, 0);
    }

    /// When what was asked for is asked for again; `None` if nothing was.
    pub fn ask_again_at(&self, wait: u64, slowest: u64) -> Option<u64> {
        let wait = (wait << self.tries.saturating_sub(PROMPT_TRIES).min(6)).min(slowest.max(wait));
        self.asked_at.map(|at| at + wait)
    }

    pub fn forget_asked(&mut self) {
        self.asked_at = None;
        self.asked.clear();
    }

    /// Whether segments before `end` are missing that were not asked for.
    pub fn has_wanted(&self, end: u32) -> bool {
        if self.total == 0 {
            return self.asked_at.is_none();
        }
        self.missing > 0 && self.wanted(0, end).is_some()
    }

    /// Appends ranges of missing segments before `end` that were not asked for, as long as there
    /// are fewer than `most`.
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

    /// How long ago this was asked for, if it was asked for once.
    pub fn answered_in(&self, now: u64, index: u32) -> Option<u64> {
        let asked = self.tries == 1 && (self.total == 0 || self.asked.get(index));
        self.asked_at.filter(|_| asked).map(|at| now - at)
    }

    fn restart(&mut self, cut: u16, total: u32) {
        (self.cut, self.total, self.missing) = (cut, total, total);
        self.received.clear();
        self.asked.clear();
    }

    /// The first segment from `from` on and before `end` that is missing and was not asked for.
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

/// A bitmap that takes no memory of its own up to 64 bits.
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

    /// One of `total` bits.
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
