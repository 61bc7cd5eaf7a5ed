//! The replay window of a session, over its last 1024 sequences.

use super::DropReason;

const SPAN: u64 = 1024;

/// A sliding bitmap (as in RFC 4303 §3.4.3). Sequences start at 1. Only verified messages advance
/// it, so only the writer can move honest messages out of the window.
#[derive(Debug, Default)]
pub struct ReplayWindow {
    highest: u64,
    bits: [u64; (SPAN / 64) as usize],
}

impl ReplayWindow {
    /// Checks whether a message of this sequence may still be delivered.
    pub fn check(&self, sequence: u64) -> Result<(), DropReason> {
        if sequence > self.highest {
            return Ok(());
        }
        if self.highest - sequence >= SPAN {
            return Err(DropReason::TooOld);
        }
        let (word, bit) = word_and_bit(sequence);
        if self.bits[word] & bit == 0 { Ok(()) } else { Err(DropReason::Duplicate) }
    }

    /// Records a sequence as delivered, and advances the window if it is the highest.
    pub fn record(&mut self, sequence: u64) {
        if sequence > self.highest {
            for passed in (self.highest + 1..=sequence).take(SPAN as usize) {
                // If the step exceeds the whole window, all bits are cleared, in any order.
                let (word, bit) = word_and_bit(passed);
                self.bits[word] &= !bit;
            }
            self.highest = sequence;
        } else if self.highest - sequence >= SPAN {
            return;
        }
        let (word, bit) = word_and_bit(sequence);
        self.bits[word] |= bit;
    }
}

fn word_and_bit(sequence: u64) -> (usize, u64) {
    let at = sequence % SPAN;
    ((at / 64) as usize, 1 << (at % 64))
}

#[cfg(test)]
#[path = "../../tests/unit/seal/window.rs"]
mod tests;
