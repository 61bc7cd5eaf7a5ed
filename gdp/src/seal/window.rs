//! Which sequences of a session are done, over the last 1024 of them.

use super::DropReason;

const SPAN: u64 = 1024;

/// A sliding bitmap (as in RFC 4303 §3.4.3). Sequences begin at 1. Only what was verified moves it, so that nobody but
/// the writer can push honest messages out of it.
#[derive(Debug)]
pub struct Window {
    highest: u64,
    bits: [u64; (SPAN / 64) as usize],
}

impl Window {
    pub fn new() -> Self {
        Self { highest: 0, bits: [0; (SPAN / 64) as usize] }
    }

    /// Whether a message of this sequence is still wanted.
    pub fn check(&self, sequence: u64) -> Result<(), DropReason> {
        if sequence > self.highest {
            return Ok(());
        }
        if self.highest - sequence >= SPAN {
            return Err(DropReason::TooOld);
        }
        let (word, bit) = place(sequence);
        if self.bits[word] & bit == 0 { Ok(()) } else { Err(DropReason::Duplicate) }
    }

    /// Marks a sequence as done, and moves on if it is the highest.
    pub fn record(&mut self, sequence: u64) {
        if sequence > self.highest {
            for passed in (self.highest + 1..=sequence).take(SPAN as usize) {
                // When more than the whole window is passed, all of it is cleared, in whatever order.
                let (word, bit) = place(passed);
                self.bits[word] &= !bit;
            }
            self.highest = sequence;
        } else if self.highest - sequence >= SPAN {
            return;
        }
        let (word, bit) = place(sequence);
        self.bits[word] |= bit;
    }
}

fn place(sequence: u64) -> (usize, u64) {
    let at = sequence % SPAN;
    ((at / 64) as usize, 1 << (at % 64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn it_agrees_with_a_set() {
        let mut window = Window::new();
        let (mut done, mut highest) = (BTreeSet::new(), 0u64);
        let mut random = super::super::tests::Random(1);
        for _ in 0..50_000 {
            let step = if random.below(500) == 0 { 3000 } else { 8 };
            let sequence = (highest + random.below(step)).saturating_sub(random.below(1100)).max(1);
            let expected = if highest >= SPAN && sequence <= highest - SPAN {
                Err(DropReason::TooOld)
            } else if done.contains(&sequence) {
                Err(DropReason::Duplicate)
            } else {
                Ok(())
            };
            assert_eq!(window.check(sequence), expected, "{sequence} of {highest}");
            if expected.is_ok() {
                window.record(sequence);
                done.insert(sequence);
                highest = highest.max(sequence);
            }
        }
    }

    #[test]
    fn the_ends_of_the_number_range() {
        let mut window = Window::new();
        window.record(u64::MAX);
        assert_eq!(window.check(u64::MAX), Err(DropReason::Duplicate));
        assert_eq!(window.check(1), Err(DropReason::TooOld));
        assert_eq!(window.check(u64::MAX - 1023), Ok(()));
        window.record(1);
        assert_eq!(window.check(u64::MAX - 1023), Ok(()));
    }
}
