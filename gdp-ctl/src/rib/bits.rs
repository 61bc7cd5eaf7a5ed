//! Which egress bit each switch of the domain has. Pure; the RIB calls it.

use std::collections::{BTreeMap, VecDeque};

use gdp_wire::Name;
use gdp_wire::table::EGRESS_SET_SIZE;

use super::journal::{Item, Journal};

/// The domain has as many switches as an egress set has bits.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("this RIB already routes between {EGRESS_SET_SIZE} switches, the most one egress set can name")]
pub struct Full;

#[derive(Debug)]
pub struct Bits {
    given: BTreeMap<Name, u8>,
    /// Longest free first, so that a bit still on its way in frames is not soon someone else's.
    free: VecDeque<u8>,
    journal: Journal,
}

impl Default for Bits {
    fn default() -> Self {
        let free = (0..EGRESS_SET_SIZE as u8).collect();
        Self { given: BTreeMap::new(), free, journal: Journal::default() }
    }
}

impl Bits {
    /// Gives a switch that is new a bit, which it keeps until it is forgotten: the one it `had`, if that is free, or else one
    /// that is not `taken` by somebody who is not known here, if there is such a one.
    pub fn give(&mut self, switch: Name, had: Option<u8>, taken: impl Fn(u8) -> bool) -> Result<(), Full> {
        if !self.given.contains_key(&switch) {
            let same = self.free.iter().position(|bit| Some(*bit) == had);
            let place = same.or_else(|| self.free.iter().position(|bit| !taken(*bit))).unwrap_or(0);
            let bit = self.free.remove(place).ok_or(Full)?;
            self.given.insert(switch, bit);
            self.journal.mark(Item::Switch(switch));
        }
        Ok(())
    }

    /// Gives a switch another bit than it has.
    pub fn exchange(&mut self, switch: Name, taken: impl Fn(u8) -> bool) -> Result<(), Full> {
        let Some(old) = self.given.remove(&switch) else { return Ok(()) };
        let given = self.give(switch, None, taken);
        match given {
            Ok(()) => self.free.push_back(old),
            Err(Full) => drop(self.given.insert(switch, old)),
        }
        given
    }

    /// Frees the bit of a switch.
    pub fn forget(&mut self, switch: &Name) {
        self.journal.mark(Item::Switch(*switch));
        self.free.extend(self.given.remove(switch));
    }

    /// The switch's egress bit (0 … 63).
    pub fn of(&self, switch: &Name) -> Option<u8> {
        self.given.get(switch).copied()
    }

    pub(super) fn journal(&mut self) -> &mut Journal {
        &mut self.journal
    }

    pub fn all(&self) -> impl Iterator<Item = (Name, u8)> {
        self.given.iter().map(|(switch, bit)| (*switch, *bit))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_stable_and_run_out_with_an_error() {
        let mut bits = Bits::default();
        for i in 0..64 {
            bits.give(name(i), None, free).unwrap();
            assert_eq!(bits.of(&name(i)), Some(i));
        }
        assert_eq!(bits.give(name(64), None, free), Err(Full));
        assert_eq!(bits.exchange(name(3), free), Err(Full));
        bits.give(name(5), Some(9), free).unwrap();
        assert_eq!((bits.of(&name(5)), bits.of(&name(3))), (Some(5), Some(3)));
        bits.forget(&name(7));
        bits.give(name(64), None, free).unwrap();
        assert_eq!((bits.of(&name(64)), bits.of(&name(7))), (Some(7), None));
    }

    #[test]
    fn a_switch_gets_the_bit_it_had_if_that_is_free() {
        let mut bits = Bits::default();
        for (i, had, gets) in [(1, Some(7), 7), (2, None, 0), (3, Some(7), 1), (4, Some(64), 2), (1, Some(9), 7)] {
            bits.give(name(i), had, free).unwrap();
            assert_eq!(bits.of(&name(i)), Some(gets));
        }
    }

    #[test]
    fn what_others_have_is_given_last() {
        let mut bits = Bits::default();
        let taken = |bit| bit != 9;
        for (i, had, gets) in [(1, None, 9), (2, Some(4), 4), (3, None, 0)] {
            bits.give(name(i), had, taken).unwrap();
            assert_eq!(bits.of(&name(i)), Some(gets));
        }
        bits.exchange(name(1), |bit| bit < 20).unwrap();
        assert_eq!(bits.of(&name(1)), Some(20));
        bits.give(name(4), Some(9), taken).unwrap();
        assert_eq!(bits.of(&name(4)), Some(9), "it is free again");
    }

    fn free(_: u8) -> bool {
        false
    }

    fn name(i: u8) -> Name {
        Name::from_bytes([i; 32])
    }
}
