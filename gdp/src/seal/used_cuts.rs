//! Which cuts of its messages a writer has used. A cut that came twice would seal twice under one nonce.

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
mod tests {
    use super::*;

    #[test]
    fn no_cut_is_used_twice_however_many_there_are() {
        let mut used = UsedCuts::default();
        let mut taken = std::collections::HashSet::new();
        let mut random = super::super::tests::Random(1);
        for _ in 0..30_000 {
            let (sequence, cut) = (1 + random.below(6000), random.below(4) as u16);
            if used.take(sequence, cut).is_ok() {
                assert!(cut > 0 && taken.insert((sequence, cut)), "{sequence} {cut}");
            }
            assert!(used.highest.len() <= MAX_MESSAGES);
        }
        assert!(used.floor > 0 && taken.len() > MAX_MESSAGES);
        assert!(used.take(u64::MAX, u16::MAX).is_err());
        assert!(used.take(u64::MAX, u16::MAX - 1).is_ok());
    }
}
