//! Probes that wait for their answers.

use std::collections::HashMap;
use std::time::Instant;

use gdp_core::name::NamePrefix;
use gdp_proto::control::Traced;
use gdp_wire::Name;
use tokio::sync::oneshot;

/// Egress switches that are probed for a neighbour, at most.
pub const MAX_EGRESS: usize = 8;

/// Probes for users of this domain that wait for their answers at once.
const MAX_OUTSTANDING: usize = 64;

/// The same for each neighbouring domain, besides: two of its traces.
const MAX_FOR_NEIGHBOUR: usize = 2 * MAX_EGRESS;

/// The probes that wait for their answers. Each domain has its share: what others trace here keeps
/// nobody else from it.
#[derive(Default)]
pub struct Probes(HashMap<u64, PendingProbe>);

struct PendingProbe {
    /// The neighbouring domain that asked; none for this one.
    asked_by: Option<Name>,
    answer: oneshot::Sender<(Traced, Instant)>,
}

impl Probes {
    /// How many more there may be for a neighbouring domain, or this one. Probes that nobody waits
    /// for any more do not count.
    pub fn room(&mut self, asked_by: Option<Name>) -> usize {
        self.0.retain(|_, probe| !probe.answer.is_closed());
        let pending = self.0.values().filter(|probe| probe.asked_by == asked_by).count();
        share(asked_by).saturating_sub(pending)
    }

    /// An answer with this cookie is waited for from now on, until the receiver is dropped.
    pub fn wait(
        &mut self,
        asked_by: Option<Name>,
        cookie: u64,
    ) -> Result<oneshot::Receiver<(Traced, Instant)>, ProbeError> {
        if self.room(asked_by) == 0 {
            return Err(ProbeError::Busy(share(asked_by)));
        }
        let (answer, waiting) = oneshot::channel();
        self.0.insert(cookie, PendingProbe { asked_by, answer });
        Ok(waiting)
    }

    /// An answer has come.
    pub fn answer(&mut self, answer: Traced) {
        if let Some(probe) = self.0.remove(&answer.cookie) {
            // Whoever asked may have given up.
            let _ = probe.answer.send((answer, Instant::now()));
        }
    }
}

fn share(asked_by: Option<Name>) -> usize {
    if asked_by.is_some() { MAX_FOR_NEIGHBOUR } else { MAX_OUTSTANDING }
}

/// Why there is nothing to probe.
#[derive(Debug, thiserror::Error)]
pub enum ProbeError {
    #[error("this switch knows no name that begins with {0}")]
    Unknown(NamePrefix),
    #[error("several names begin with {0}; give more of its digits")]
    Ambiguous(NamePrefix),
    #[error(
        "this switch knows no way to {0:#}: it is no switch, has no link here, and nobody attached here may send to \
         it; ask at a switch \
         where somebody is who does"
    )]
    NoWay(Name),
    #[error("there is no path to switch {0:#} now")]
    NoPath(Name),
    #[error("there is no link to {0:#} now")]
    NoLink(Name),
    #[error("{0} probes wait for their answers already; try again")]
    Busy(usize),
    #[error("no random number for a cookie: {0}")]
    Random(String),
}

/// Where a name is, as this switch sees it.
pub struct Location {
    pub name: Name,
    /// Echoes reach it by a link of this switch.
    pub is_near: bool,
    /// The egress switches of the name; of a switch, itself.
    pub egress: Vec<Name>,
}

#[cfg(test)]
#[path = "../../../tests/unit/serve/probes.rs"]
mod tests;
