//! Link-state database: the newest statement of each switch until it expires. It is bounded: new
//! switches displace unreachable ones.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::time::Duration;

use gdp_core::cert::LinkState;
use gdp_proto::control::Flooded;
use gdp_wire::Name;
use gdp_wire::table::EGRESS_SET_SIZE;

/// Maximum number of known switches: those with an egress bit, and further ones that only forward
/// frames.
const MAX_SWITCHES: usize = 4 * EGRESS_SET_SIZE as usize;

#[derive(Clone, Debug, Default)]
pub struct Database(BTreeMap<Name, StoredState>);

#[derive(Clone, Debug)]
struct StoredState {
    flooded: Flooded,
    claims: LinkState,
    expires: Duration,
}

/// Outcome of storing a statement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taken {
    /// The statement is the newest. `changed`: its content differs from the one before.
    News {
        changed: bool,
    },
    Known,
    Older,
    NoRoom,
}

impl Database {
    /// Stores a statement that is newer than the present one. Without room, it displaces one whose
    /// switch is not `reached`.
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

    /// Removes expired statements. Returns whether there were any.
    pub fn expire(&mut self, now: Duration) -> bool {
        let before = self.0.len();
        self.0.retain(|_, held| held.expires > now);
        self.0.len() != before
    }

    pub fn next_expiry(&self) -> Option<Duration> {
        self.0.values().map(|held| held.expires).min()
    }

    /// Compares the age of a statement with that of the stored one.
    ///
    /// A switch that lost its numbers may state different content under a used number. All switches
    /// then prefer the same one of the two, and the switch itself continues with a higher number.
    /// Signatures do not count: a switch that signs one payload twice has stated nothing new.
    pub fn compare(&self, flooded: &Flooded, claims: &LinkState) -> Ordering {
        let Some(held) = self.0.get(&claims.switch) else { return Ordering::Greater };
        let payload = |flooded: &Flooded| flooded.state.payload_unverified().ok();
        let by_version = claims.version().cmp(&held.claims.version());
        by_version.then_with(|| payload(flooded).cmp(&payload(&held.flooded)))
    }

    /// Returns the statement of a switch for flooding, or `None` if it expires within a second.
    pub fn flooded(&self, now: Duration, switch: &Name) -> Option<Flooded> {
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
