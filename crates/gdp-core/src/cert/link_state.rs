//! Link state of a switch, which it states to all switches of its domain. It holds the egress bit,
//! whether the RIB is there, and the links within the domain and to other domains.

use super::{Claims, Validity};
use crate::cert::error::CertError;
use crate::name::Name;
use gdp_wire::table::EGRESS_SET_SIZE;
use serde::{Deserialize, Serialize};

/// Maximum number of neighbours that one switch states. With them and [`MAX_BORDERS`] the statement
/// still has the size of one certificate.
pub const MAX_NEIGHBOURS: usize = 45;

/// Maximum number of links into other domains that one switch states.
pub const MAX_BORDERS: usize = 16;

/// Maximum lifetime of a statement in seconds without renewal.
pub const MAX_LIFETIME: u32 = 3600;

/// Link state of a switch, signed by its own key. The newest statement counts.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkState {
    pub switch: Name,
    /// Run of the switch, which is higher after a restart.
    pub run: u64,
    /// Number of the statement within the run, increasing.
    pub number: u64,
    /// Index (0 to 63) of the switch's egress bit, once it has one.
    pub bit: Option<u8>,
    /// Neighbours in the order of their names, with the cost of a frame to each, at least 1.
    pub neighbours: Vec<(Name, u32)>,
    /// Bit mask of silent neighbours. Bit i is set if the daemon of neighbour i does not answer
    /// though its data plane does. Frames may go that way, control messages may not.
    pub silent: u64,
    /// The domain's RIB runs beside this switch.
    pub rib: bool,
    /// Border links in the order of domains and switches.
    pub borders: Vec<Adjoining>,
    /// Lifetime in seconds since the statement, as far as that time is known, on the clock of each
    /// holder.
    pub lifetime: u32,
}

/// Link of a border switch into another domain.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Adjoining {
    pub domain: Name,
    /// Border switch of the other domain.
    pub switch: Name,
    /// Cost of a frame over the link, at least 1.
    pub cost: u32,
    /// The other domain lets this one's traffic cross it into a third.
    pub transit: bool,
    /// This domain lets the other one's traffic cross it into a third.
    pub ours_transit: bool,
    /// Position among the parents if the other domain's RIB is one. Lower numbers are asked first.
    pub parent: Option<u8>,
}

impl LinkState {
    /// Returns the version of the statement. Of two statements of a switch, the one with the higher
    /// version is newer.
    pub fn version(&self) -> (u64, u64) {
        (self.run, self.number)
    }
}

impl Claims for LinkState {
    const KIND: &'static str = "LinkState";
    const LABEL: &'static str = "GDP LINK STATE";
    const CONTEXT: &'static str = "application/vnd.gdp.link-state.v2+cbor";

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
