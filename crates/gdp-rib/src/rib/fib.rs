//! Desired FIB of one switch as a [`Feed`] of routes, and the last answer of the switch. Pure
//! state: the RIB fills it and sends what [`Fib::next`] returns.

use std::time::Duration;

use gdp_proto::control::{FibPush, Route};
use gdp_wire::Name;

use crate::feed::{Feed, Room};

/// Capacity of one push. A message has at most 64 KiB, and the remainder is for the envelope. A
/// single route always fits: a name has at most 256 writers, and at most one reader at a switch for
/// each link.
const ROOM: Room = Room { entries: NAMES_PER_PUSH, bytes: 56 * 1024 };
const NAMES_PER_PUSH: usize = 400;

/// Encoded size in bytes of a route without endpoints, and of each endpoint, including field names.
const ROUTE_SIZE: usize = 144;
const ENDPOINT_SIZE: usize = 34;

/// Desired FIB of one switch, and how much of it the switch is known to hold.
#[derive(Debug, Default)]
pub struct Fib {
    routes: Feed<[u8; 32], Route>,
    /// Reason why the data plane of the switch holds only part of the pushed routes.
    lacking: Option<String>,
}

/// Fields of a push besides its routes, as in [`FibPush`].
#[derive(Clone, Debug)]
pub struct About {
    pub switch: Name,
    pub run: u64,
    pub settling: bool,
    pub own_bit: u8,
}

/// Outcome of a push.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Pushed {
    Done,
    /// The switch follows, but its data plane has no room for all routes, for this reason.
    Partly(String),
    /// The push failed, or its outcome is unknown.
    Failed,
}

impl Fib {
    /// Sets the desired route of a name, or removes it if `route` is `None`.
    pub fn set(&mut self, name: &Name, route: Option<Route>) {
        self.routes.set(name.to_bytes(), route);
    }

    /// Starts a full transfer, for a switch that is new, was away or changes its bit. The answer to
    /// a push still in flight is ignored.
    pub fn restart(&mut self) {
        self.routes.restart();
    }

    /// Returns the next push, or `None` if one is in flight or nothing has changed.
    pub fn next(&mut self, now: Duration, about: About) -> Option<FibPush> {
        let parcel = self.routes.next(now, ROOM, size)?;
        let About { switch, run, settling, own_bit } = about;
        let remove = parcel.remove.into_iter().map(Name::from_bytes).collect();
        let (generation, extent, set) = (parcel.generation, parcel.extent, parcel.set);
        Some(FibPush { switch, run, settling, generation, extent, own_bit, set, remove })
    }

    /// Records the outcome of the push with this generation. After a failure a full transfer
    /// follows shortly.
    pub fn answered(&mut self, now: Duration, generation: u64, outcome: Pushed) {
        if !self.routes.answered(now, generation, outcome != Pushed::Failed) {
            return;
        }
        match outcome {
            Pushed::Done => self.lacking = None,
            Pushed::Partly(reason) => self.lacking = Some(reason),
            Pushed::Failed => {}
        }
    }

    /// Returns whether the switch has answered the current route of this name.
    ///
    /// Also returns true once pushes have failed more than once, because waiting is then pointless.
    pub fn is_settled(&self, name: &[u8; 32]) -> bool {
        self.routes.is_settled(name)
    }

    /// Returns the reason, last stated by the switch, why its data plane has no room.
    pub fn lacking(&self) -> Option<&str> {
        self.lacking.as_deref()
    }

    /// Returns the time at which [`Self::next`] should be called again if nothing else happens.
    pub fn retry_at(&self) -> Option<Duration> {
        self.routes.retry_at()
    }

    /// Returns all routes that the switch should hold.
    pub fn routes(&self) -> impl Iterator<Item = &Route> {
        self.routes.entries().values()
    }
}

/// Returns the bytes of a route in a push, or of the name of a removed route if given `None`.
fn size(route: Option<&Route>) -> usize {
    let ends = |route: &Route| route.locals.len() + route.writers.len() + route.arrives_by.len();
    ROUTE_SIZE + route.map_or(0, ends) * ENDPOINT_SIZE
}

#[cfg(test)]
#[path = "../../tests/unit/rib/fib.rs"]
mod tests;
