//! The newest statement of each switch, until it expires. Bounded; whoever is not reached makes
//! room for whoever is new.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::time::Duration;

use gdp_core::cert::LinkState;
use gdp_proto::control::Flooded;
use gdp_wire::Name;
use gdp_wire::table::EGRESS_SET_SIZE;

/// Switches of which something is known: those that have an egress bit, and as many that only pass
/// frames on.
const MAX_SWITCHES: usize = 4 * EGRESS_SET_SIZE as usize;

#[derive(Default)]
pub struct Database(BTreeMap<Name, StoredState>);

struct StoredState {
    flooded: Flooded,
    claims: LinkState,
    expires: Duration,
}

/// What became of a statement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taken {
    /// It is the newest. `changed`: it says something else than the one before.
    News {
        changed: bool,
    },
    Known,
    Older,
    NoRoom,
}

impl Database {
    /// Keeps a statement that is newer than what is held. If there is no room, one of those goes
    /// that are not `reached`.
    pub fn take(
        &mut self,
        now: Duration,
        flooded: Flooded,
        claims: LinkState,
        reached: impl Fn(&Name) -> bool,
    ) -> Taken {
        match self.compare(&flooded, &claims) {
            Ordering::Greater => {}
            Ordering::Equal => return Taken::Known,
            Ordering::Less => return Taken::Older,
        }
        let says = |state: &LinkState| LinkState { number: 0, lifetime: 0, ..state.clone() };
        let changed = self.0.get(&claims.switch).is_none_or(|held| says(&held.claims) != says(&claims));
        if self.0.len() >= MAX_SWITCHES && !self.0.contains_key(&claims.switch) {
            let Some(useless) = self.0.keys().find(|switch| !reached(switch)).copied() else { return Taken::NoRoom };
            self.0.remove(&useless);
        }
        let left = flooded.expires_in.min(claims.lifetime);
        let expires = now + Duration::from_secs(left.into());
        self.0.insert(claims.switch, StoredState { flooded, claims, expires });
        Taken::News { changed }
    }

    /// Forgets what is over; whether there was any.
    pub fn expire(&mut self, now: Duration) -> bool {
        let before = self.0.len();
        self.0.retain(|_, held| held.expires > now);
        self.0.len() != before
    }

    pub fn next_expiry(&self) -> Option<Duration> {
        self.0.values().map(|held| held.expires).min()
    }

    /// Whether a statement is newer than what is held, the same, or older. A switch that lost its
    /// numbers may state other things under one it has used: then all agree on one of the two, and
    /// the switch itself goes above.
    pub fn compare(&self, flooded: &Flooded, claims: &LinkState) -> Ordering {
        let Some(held) = self.0.get(&claims.switch) else { return Ordering::Greater };
        let age = |claims: &LinkState, flooded: &Flooded| (claims.version(), flooded.state.as_bytes().to_vec());
        age(claims, flooded).cmp(&age(&held.claims, &held.flooded))
    }

    /// What a neighbour is to be told of a switch; nothing if that is over in a moment.
    pub fn told(&self, now: Duration, switch: &Name) -> Option<Flooded> {
        let held = self.0.get(switch)?;
        let expires_in = u32::try_from(held.expires.saturating_sub(now).as_secs()).unwrap_or(u32::MAX);
        (expires_in > 0).then(|| Flooded { expires_in, ..held.flooded.clone() })
    }

    pub fn switches(&self) -> impl Iterator<Item = &Name> {
        self.0.keys()
    }

    pub fn claims(&self) -> impl Iterator<Item = &LinkState> {
        self.0.values().map(|held| &held.claims)
    }
}

#[cfg(test)]
#[path = "../../tests/unit/topology/database.rs"]
mod tests;
