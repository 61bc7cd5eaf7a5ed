//! Which cuts of its messages a writer has used. A cut that came twice would seal twice under one
//! nonce.

use std::collections::BTreeMap;

/// Messages that were cut anew and are remembered. Those before them cannot be cut anew any more.
const MAX_MESSAGES: usize = 4096;

/// All messages have used cut 0.
#[derive(Debug, Default)]
pub struct UsedCuts {
    /// By sequence, the highest cut used, if it is not 0.
    highest: BTreeMap<u64, u16>,
    /// What is no higher has been forgotten.
    floor: u64,
}

impl UsedCuts {
    /// Uses a cut, or says why it cannot be.
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
