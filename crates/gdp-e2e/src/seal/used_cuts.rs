//! The used cuts of a writer's messages. Sealing under the same cut twice would repeat a nonce.

use std::collections::BTreeMap;

/// Maximum number of remembered messages with a new cut. Earlier messages cannot be cut again.
const MAX_MESSAGES: usize = 4096;

/// The highest used cut of each message. All messages have used cut 0.
#[derive(Debug, Default)]
pub struct UsedCuts {
    /// The highest used cut by sequence, if it is not 0.
    highest: BTreeMap<u64, u16>,
    /// Sequences up to this one have been forgotten.
    floor: u64,
}

impl UsedCuts {
    /// Uses a cut, or returns the reason for a refusal.
    pub fn take(&mut self, sequence: u64, cut: u16) -> Result<(), &'static str> {
        if cut > super::wire::MAX_CUT {
            return Err("there are no cuts beyond 65534");
        }
        if sequence <= self.floor {
            return Err("the message is too old to know which of its cuts were used");
        }
        if cut <= self.highest.get(&sequence).copied().unwrap_or(0) {
            return Err("this cut or a higher one was used");
        }
        self.highest.insert(sequence, cut);
        if self.highest.len() > MAX_MESSAGES
            && let Some((forgotten, _)) = self.highest.pop_first()
        {
            self.floor = forgotten;
        }
        Ok(())
    }
}

#[cfg(test)]
#[path = "../../tests/unit/seal/used_cuts.rs"]
mod tests;
