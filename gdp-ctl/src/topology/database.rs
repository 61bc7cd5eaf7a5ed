//! The newest statement of each switch, until it expires. Bounded; whoever is not reached makes room for whoever is new.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::time::Duration;

use gdp::cert::LinkState;
use gdp::control::Flooded;
use gdp_wire::Name;
use gdp_wire::table::EGRESS_SET_SIZE;

/// Switches of which something is known: those that have an egress bit, and as many that only pass frames on.
const MAX_SWITCHES: usize = 4 * EGRESS_SET_SIZE as usize;

#[derive(Default)]
pub struct Database(BTreeMap<Name, Held>);

struct Held {
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
    /// Keeps a statement that is newer than what is held. If there is no room, one of those goes that are not `reached`.
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
        self.0.insert(claims.switch, Held { flooded, claims, expires });
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

    /// Whether a statement is newer than what is held, the same, or older. A switch that lost its numbers may state other things
    /// under one it has used: then all agree on one of the two, and the switch itself goes above.
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
mod tests {
    use super::*;
    use gdp::cert::issue;
    use gdp::identity::SigningKey;
    use gdp::name::NameProof;

    const NOW: Duration = Duration::from_secs(1000);

    #[test]
    fn the_newest_counts_and_ends_in_time() {
        let mut database = Database::default();
        let take = |d: &mut Database, run, number, expires_in| {
            let (flooded, claims) = state(1, run, number, expires_in);
            d.take(NOW, flooded, claims, |_| true)
        };
        let twice = [state(1, 2, 5, 100), state(1, 2, 5, 100)];
        let newer = twice.iter().max_by_key(|(flooded, _)| flooded.state.as_bytes()).unwrap();
        let take_again = |d: &mut Database, (flooded, claims): &(Flooded, LinkState)| {
            d.take(NOW, flooded.clone(), claims.clone(), |_| true)
        };
        assert_eq!(take_again(&mut database, newer), Taken::News { changed: true });
        assert_eq!(take_again(&mut database, newer), Taken::Known);
        let older = twice.iter().find(|other| *other != newer).unwrap();
        assert_eq!(take_again(&mut database, older), Taken::Older, "of the same number, one of the two");
        assert_eq!(take(&mut database, 2, 4, 100), Taken::Older);
        assert_eq!(take(&mut database, 1, 9, 100), Taken::Older);
        assert_eq!(take(&mut database, 2, 6, 10), Taken::News { changed: false });
        assert_eq!(
            take(&mut database, 3, 1, u32::MAX),
            Taken::News { changed: true },
            "another run may keep another bit"
        );
        let seconds = Duration::from_secs;
        assert_eq!(database.next_expiry(), Some(NOW + seconds(180)), "not longer than it says itself");
        assert_eq!(database.told(NOW + seconds(80), &name(1)).map(|told| told.expires_in), Some(100));
        assert_eq!(database.told(NOW + Duration::from_millis(179_500), &name(1)), None);
        assert!(!database.expire(NOW + seconds(179)) && database.expire(NOW + seconds(180)));
        assert_eq!(database.switches().count(), 0);
    }

    #[test]
    fn whoever_is_not_reached_makes_room() {
        let mut database = Database::default();
        for i in 0..MAX_SWITCHES as u16 {
            let (flooded, claims) = state(i, 1, 1, 100);
            assert_eq!(database.take(NOW, flooded, claims, |_| true), Taken::News { changed: true });
        }
        let (flooded, claims) = state(999, 1, 1, 100);
        assert_eq!(database.take(NOW, flooded.clone(), claims.clone(), |_| true), Taken::NoRoom);
        assert_eq!(database.take(NOW, flooded, claims, |n| *n != name(7)), Taken::News { changed: true });
        assert!(database.switches().count() == MAX_SWITCHES && database.switches().all(|n| *n != name(7)));
    }

    fn state(i: u16, run: u64, number: u64, expires_in: u32) -> (Flooded, LinkState) {
        let key = SigningKey::generate().unwrap();
        let claims = LinkState {
            switch: name(i),
            run,
            number,
            bit: None,
            neighbours: vec![],
            silent: 0,
            rib: false,
            borders: vec![],
            lifetime: 180,
        };
        let proof = NameProof { owner_key: key.public(), digest: [0; 32] };
        (Flooded { proof, state: issue(&key, &claims).unwrap(), expires_in }, claims)
    }

    fn name(i: u16) -> Name {
        let mut bytes = [0; 32];
        bytes[..2].copy_from_slice(&i.to_be_bytes());
        Name::from_bytes(bytes)
    }
}
