//! What a switch states of itself to all switches of its domain: its egress bit, whether the RIB is
//! there, and which switches it has links with, in the domain and in others.

use super::{Claims, Validity};
use crate::cert::error::CertError;
use crate::name::Name;
use gdp_wire::table::EGRESS_SET_SIZE;
use serde::{Deserialize, Serialize};

/// Neighbours that one switch states, at most: with them and [`MAX_BORDERS`] the statement is still
/// one certificate's size.
pub const MAX_NEIGHBOURS: usize = 45;

/// Links into other domains that one switch states, at most.
pub const MAX_BORDERS: usize = 16;

/// The longest that a statement may hold without being renewed, in seconds.
pub const MAX_LIFETIME: u32 = 3600;

/// A switch → the switches of its domain: these are my neighbours. Signed by its own key; the
/// newest counts.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinkState {
    pub switch: Name,
    /// Which run of the switch this is: higher after a restart.
    pub run: u64,
    /// Rises with every statement of the run.
    pub number: u64,
    /// Index (0 … 63) of its egress bit, once it has one.
    pub bit: Option<u8>,
    /// In the order of their names, with what a frame to each costs: 1 or more.
    pub neighbours: Vec<(Name, u32)>,
    /// Bit i: the daemon of neighbour i does not answer, though its data plane does. Frames may go
    /// that way, control may not.
    pub silent: u64,
    /// The domain's RIB is here.
    pub rib: bool,
    /// In the order of domains and switches.
    pub borders: Vec<Adjoining>,
    /// Seconds from when it was stated, as far as that is known: on the clock of whoever holds it.
    pub lifetime: u32,
}

/// A link of a border switch into another domain.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Adjoining {
    pub domain: Name,
    /// The border switch over there.
    pub switch: Name,
    /// What a frame over the link costs: 1 or more.
    pub cost: u32,
    /// That domain lets what this one sends cross it into a third.
    pub transit: bool,
    /// This domain lets that one do so.
    pub ours_transit: bool,
    /// The RIB of that domain is a parent of this one's; those with a lower number are asked
    /// before.
    pub parent: Option<u8>,
}

impl LinkState {
    /// Of two statements of a switch the one with the higher version is the newer.
    pub fn version(&self) -> (u64, u64) {
        (self.run, self.number)
    }
}

impl Claims for LinkState {
    const KIND: &'static str = "LinkState";
    const LABEL: &'static str = "GDP LINK STATE";
    const CONTEXT: &'static str = "application/vnd.gdp.link-state.v1+cbor";

    fn validity(&self) -> Validity {
        Validity::ALWAYS
    }

    fn check_bounds(&self) -> Result<(), CertError> {
        let malformed = |what: String| Err(CertError::Malformed(what));
        if self.neighbours.len() > MAX_NEIGHBOURS {
            return malformed(format!("{} neighbours where at most {MAX_NEIGHBOURS} fit", self.neighbours.len()));
        }
        if !self.neighbours.is_sorted_by(|(a, _), (b, _)| a < b) {
            return malformed("its neighbours are not in the order of their names".into());
        }
        if self.neighbours.iter().any(|(name, cost)| *cost == 0 || *name == self.switch) {
            return malformed("a neighbour costs nothing, or is the switch itself".into());
        }
        if self.silent.checked_shr(self.neighbours.len() as u32).unwrap_or(0) != 0 {
            return malformed("neighbours are silent that are none".into());
        }
        if self.borders.len() > MAX_BORDERS {
            return malformed(format!(
                "{} links into other domains where at most {MAX_BORDERS} fit",
                self.borders.len()
            ));
        }
        let place = |border: &Adjoining| (border.domain, border.switch);
        if !self.borders.is_sorted_by(|a, b| place(a) < place(b)) {
            return malformed("its links into other domains are not in the order of domains and switches".into());
        }
        if self.borders.iter().any(|border| border.cost == 0 || border.switch == self.switch) {
            return malformed("a link into another domain costs nothing, or leads to the switch itself".into());
        }
        if self.bit.is_some_and(|bit| u64::from(bit) >= EGRESS_SET_SIZE.into()) {
            return malformed(format!("its egress bit is not below {EGRESS_SET_SIZE}"));
        }
        if !(1..=MAX_LIFETIME).contains(&self.lifetime) {
            return malformed(format!("its lifetime is not between 1 and {MAX_LIFETIME} s"));
        }
        Ok(())
    }
}

#[cfg(test)]
#[path = "../../tests/unit/cert/link_state.rs"]
mod tests;
