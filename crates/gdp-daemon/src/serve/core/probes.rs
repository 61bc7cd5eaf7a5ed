//! The probes that wait for answers.

use std::collections::HashMap;
use std::time::Instant;

use gdp_core::name::NamePrefix;
use gdp_proto::control::Traced;
use gdp_wire::Name;
use tokio::sync::oneshot;

/// The maximum number of egress switches to probe for one trace of a neighbouring domain.
pub const MAX_EGRESS: usize = 8;

/// The maximum number of outstanding probes for users of this domain.
const MAX_OUTSTANDING: usize = 64;

/// The maximum number of outstanding probes for each neighbouring domain: two of its traces.
const MAX_FOR_NEIGHBOUR: usize = 2 * MAX_EGRESS;

/// The outstanding probes, by cookie. Each domain has its own quota, so that its traces do not
/// block others.
#[derive(Default)]
pub struct Probes(HashMap<u64, PendingProbe>);

struct PendingProbe {
    /// The neighbouring domain that asked. `None` is this domain.
    asked_by: Option<Name>,
    answer: oneshot::Sender<(Traced, Instant)>,
}

impl Probes {
    /// Returns how many more probes a neighbouring domain or this one may have outstanding. Probes
    /// whose receiver is dropped do not count.
    pub fn room(&mut self, asked_by: Option<Name>) -> usize {
        self.0.retain(|_, probe| !probe.answer.is_closed());
        let pending = self.0.values().filter(|probe| probe.asked_by == asked_by).count();
        share(asked_by).saturating_sub(pending)
    }

    /// Registers a probe. The returned receiver gets the answer with this cookie.
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

    /// Passes an answer to the receiver of its probe.
    pub fn answer(&mut self, answer: Traced) {
        if let Some(probe) = self.0.remove(&answer.cookie) {
            // The receiver may be dropped.
            let _ = probe.answer.send((answer, Instant::now()));
        }
    }
}

fn share(asked_by: Option<Name>) -> usize {
    if asked_by.is_some() { MAX_FOR_NEIGHBOUR } else { MAX_OUTSTANDING }
}

/// The reason why no probe was sent.
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

/// The location of a name, as this switch knows it.
pub struct Location {
    pub name: Name,
    /// Whether this switch has a link to the name, over which echoes reach it.
    pub is_near: bool,
    /// The egress switches of the name. A switch is its own egress.
    pub egress: Vec<Name>,
}

#[cfg(test)]
#[path = "../../../tests/unit/serve/probes.rs"]
mod tests;
