//! Assigns an egress bit to each switch of the domain. Pure state, called by the RIB.

use std::collections::{BTreeMap, VecDeque};

use gdp_wire::Name;
use gdp_wire::table::EGRESS_SET_SIZE;

use super::journal::{Item, Journal};

/// Error: all egress bits are assigned to switches.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("this RIB already routes between {EGRESS_SET_SIZE} switches, the most one egress set can name")]
pub struct Full;

#[derive(Debug)]
pub struct Bits {
    assigned: BTreeMap<Name, u8>,
    /// Free bits, the longest free first. Frames in flight may still carry a bit that was freed
    /// recently.
    free: VecDeque<u8>,
    journal: Journal,
}

impl Default for Bits {
    fn default() -> Self {
        let free = (0..EGRESS_SET_SIZE as u8).collect();
        Self { assigned: BTreeMap::new(), free, journal: Journal::default() }
    }
}

impl Bits {
    /// Assigns a bit to a switch that has none. The switch keeps the bit until it is forgotten.
    ///
    /// Prefers the bit it `had` if that is free, then a free bit that is not `taken` by an unknown
    /// switch, then any free bit.
    pub fn give(&mut self, switch: Name, had: Option<u8>, taken: impl Fn(u8) -> bool) -> Result<(), Full> {
        if !self.assigned.contains_key(&switch) {
            let same = self.free.iter().position(|bit| Some(*bit) == had);
            let place = same.or_else(|| self.free.iter().position(|bit| !taken(*bit))).unwrap_or(0);
            let bit = self.free.remove(place).ok_or(Full)?;
            self.assigned.insert(switch, bit);
            self.journal.mark(Item::Switch(switch));
        }
        Ok(())
    }

    /// Assigns a different bit to a switch that has one.
    pub fn exchange(&mut self, switch: Name, taken: impl Fn(u8) -> bool) -> Result<(), Full> {
        let Some(old) = self.assigned.remove(&switch) else { return Ok(()) };
        let given = self.give(switch, None, taken);
        match given {
            Ok(()) => self.free.push_back(old),
            Err(Full) => drop(self.assigned.insert(switch, old)),
        }
        given
    }

    /// Frees the bit of a switch.
    pub fn forget(&mut self, switch: &Name) {
        self.journal.mark(Item::Switch(*switch));
        self.free.extend(self.assigned.remove(switch));
    }

    /// Returns the switch's egress bit (0 to 63).
    pub fn of(&self, switch: &Name) -> Option<u8> {
        self.assigned.get(switch).copied()
    }

    pub(super) fn journal(&mut self) -> &mut Journal {
        &mut self.journal
    }

    pub fn all(&self) -> impl Iterator<Item = (Name, u8)> {
        self.assigned.iter().map(|(switch, bit)| (*switch, *bit))
    }
}

#[cfg(test)]
#[path = "../../tests/unit/rib/bits.rs"]
mod tests;
