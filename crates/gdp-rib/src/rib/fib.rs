//! What one switch's FIB should hold, as a [`Feed`] of routes, and what the switch last said of it.
//! Pure state; the RIB fills it and sends what [`Fib::next`] returns.

use std::time::Duration;

use gdp_proto::control::{FibPush, Route};
use gdp_wire::Name;

use crate::feed::{Feed, Room};

/// What one push takes: a message has at most 64 KiB, and the rest is for what encloses the routes.
/// A single route always fits: a name has at most as many readers at a switch as that has links,
/// and 256 writers.
const ROOM: Room = Room { entries: NAMES_PER_PUSH, bytes: 56 * 1024 };
const NAMES_PER_PUSH: usize = 400;

/// What an encoded route has without endpoints, and for each of them: names, field names.
const ROUTE_SIZE: usize = 144;
const ENDPOINT_SIZE: usize = 34;

/// The desired FIB of one switch, and how far the switch is known to hold it.
#[derive(Debug, Default)]
pub struct Fib {
    routes: Feed<[u8; 32], Route>,
    /// Why the data plane of the switch holds only part of what was pushed.
    lacking: Option<String>,
}

/// What a push says besides routes; as in [`FibPush`].
#[derive(Clone, Debug)]
pub struct About {
    pub switch: Name,
    pub run: u64,
    pub settling: bool,
    pub own_bit: u8,
}

/// What became of a push.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Pushed {
    Done,
    /// The switch follows, but its data plane has no room for all of it: why.
    Partly(String),
    /// Not carried out, or nobody knows.
    Failed,
}

impl Fib {
    /// Makes `route` the desired one of its name, or none.
    pub fn set(&mut self, name: &Name, route: Option<Route>) {
        self.routes.set(name.to_bytes(), route);
    }

    /// Sends the whole again: the switch is new or was away, or gets another bit. An answer that is
    /// still out no longer counts.
    pub fn restart(&mut self) {
        self.routes.restart();
    }

    /// The next push, unless one is out or there is nothing to say.
    pub fn next(&mut self, now: Duration, about: About) -> Option<FibPush> {
        let parcel = self.routes.next(now, ROOM, size)?;
        let About { switch, run, settling, own_bit } = about;
        let remove = parcel.remove.into_iter().map(Name::from_bytes).collect();
        let (generation, extent, set) = (parcel.generation, parcel.extent, parcel.set);
        Some(FibPush { switch, run, settling, generation, extent, own_bit, set, remove })
    }

    /// What became of the push of this generation. If it failed, the whole is sent, a little later.
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

    /// Whether the switch has answered what there is to say of this name; or has failed to, so that
    /// waiting is of no use.
    pub fn is_settled(&self, name: &[u8; 32]) -> bool {
        self.routes.is_settled(name)
    }

    /// Why the data plane of the switch has no room for more, as it last said.
    pub fn lacking(&self) -> Option<&str> {
        self.lacking.as_deref()
    }

    /// When to ask for the next push again, if nothing else happens.
    pub fn retry_at(&self) -> Option<Duration> {
        self.routes.retry_at()
    }

    /// All that the switch should hold.
    pub fn routes(&self) -> impl Iterator<Item = &Route> {
        self.routes.entries().values()
    }
}

/// Bytes of a route in a push, or of the name of one that is removed.
fn size(route: Option<&Route>) -> usize {
    let ends = |route: &Route| route.locals.len() + route.writers.len() + route.arrives_by.len();
    ROUTE_SIZE + route.map_or(0, ends) * ENDPOINT_SIZE
}

#[cfg(test)]
#[path = "../../tests/unit/rib/fib.rs"]
mod tests;
