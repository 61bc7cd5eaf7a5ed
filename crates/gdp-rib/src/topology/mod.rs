//! Topology of the domain: its switches and the paths to them. The switches flood their link
//! states, from which this switch computes shortest paths. It performs no I/O: time, links and
//! messages go in, messages and masks come out. It needs no RIB and does not know the names of
//! topics. `gdp-daemon` transports the messages, and the RIB beside this switch reads which
//! switches are reachable.
//!
//! [`database`] holds the newest statement of each switch, and [`flooding`] tracks which neighbour
//! lacks which. [`paths`] computes masks from statements, [`cost`] the cost of a link from its
//! round-trip time. [`damping`] decides which links fail too often to be used.
//!
//! Every statement is verified before it is stored ([`Verified`]). A lying switch can only state
//! links that it does not have, and an adjacency counts only if both ends state it.

pub mod cost;
pub mod damping;
mod database;
mod flooding;
mod paths;
#[cfg(test)]
#[path = "../../tests/unit/topology.rs"]
mod tests;

use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use gdp_core::cert::{Adjoining, CertError, LinkState, MAX_BORDERS, MAX_NEIGHBOURS, issue};
use gdp_core::identity::Identity;
use gdp_proto::control::Flooded;
use gdp_util::backoff::Backoff;
use gdp_wire::Name;

use cost::AVOIDED;
use database::{Database, Taken};
use flooding::Flooding;
pub use flooding::{Batch, BatchId};
pub use paths::Paths;

/// Lifetime of a statement in seconds. The switch restates it after a third of that. The remainder
/// exceeds the time for which the links of a dead daemon are held. A switch that forwards without
/// its daemon thus stays on the map.
pub const LIFETIME: u32 = 180;

const REFRESH: Duration = Duration::from_secs(LIFETIME as u64 / 3);

const _: () = assert!(LIFETIME as u64 * 2 / 3 > gdp_core::peer::GRACEFUL_RESTART_TIME.as_secs());

/// Minimum interval between two statements of this switch when its links change.
const MIN_INTERVAL: Duration = Duration::from_millis(50);

/// Intervals between two statements of this switch when its links change. The interval doubles with
/// each change within twice its length. The first change after a quiet time is stated at once. A
/// lost neighbour, and a link to avoid, are always stated after the minimum. So a flapping link is
/// stated as down rather than up.
const BACKOFF: Backoff = Backoff::new(MIN_INTERVAL, Duration::from_secs(5));

/// Statement whose switch's signature is verified.
#[derive(Clone, Debug)]
pub struct Verified {
    flooded: Flooded,
    claims: LinkState,
}

impl Verified {
    /// Verifies a statement's signature. This takes time, but no lock.
    pub fn new(flooded: Flooded) -> Result<Self, CertError> {
        let claims = flooded.verify()?;
        Ok(Self { flooded, claims })
    }
}

/// This switch's view of the switches of its domain.
///
/// The debug output has all state except for signatures.
#[derive(Clone, Debug)]
pub struct Topology {
    own: Own,
    database: Database,
    flooding: Flooding,
    paths: Paths,
    /// The paths must be recomputed from the database.
    is_stale: bool,
}

/// Link state of this switch: what it has and what it stated.
#[derive(Clone, Debug)]
struct Own {
    identity: Identity,
    version: (u64, u64),
    has: Stated,
    /// Content of the last statement. `None` forces a new statement.
    stated: Option<Stated>,
    /// Time of the last statement or attempt.
    stated_at: Option<Duration>,
    backoff: Backoff,
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Stated {
    bit: Option<u8>,
    neighbours: BTreeMap<Name, u32>,
    silent: BTreeSet<Name>,
    rib: bool,
    /// Border links by domain and switch.
    borders: BTreeMap<(Name, Name), Adjoining>,
}

impl Stated {
    /// Returns whether a neighbour or border of `before` is missing or to be avoided, or a
    /// neighbour has become silent.
    fn lacks_one_of(&self, before: &Self) -> bool {
        let is_worse = |was: u32, is: Option<u32>| is.is_none_or(|is| is == AVOIDED && was != AVOIDED);
        before.neighbours.iter().any(|(near, was)| is_worse(*was, self.neighbours.get(near).copied()))
            || !self.silent.is_subset(&before.silent)
            || before.borders.iter().any(|(at, was)| is_worse(was.cost, self.borders.get(at).map(|border| border.cost)))
    }
}

impl Topology {
    /// Creates the topology of a switch.
    ///
    /// `run` must be higher than that of the switch's last start. If it is not, the switch learns
    /// so from the first neighbour.
    pub fn new(identity: Identity, run: u64) -> Self {
        let own = Own {
            identity,
            version: (run, 0),
            has: Stated::default(),
            stated: None,
            stated_at: None,
            backoff: BACKOFF,
        };
        let (database, flooding) = (Database::default(), Flooding::default());
        Self { own, database, flooding, paths: Paths::default(), is_stale: true }
    }

    /// Sets the usable neighbours and the cost to each. At most [`MAX_NEIGHBOURS`] are stated.
    pub fn set_neighbours(&mut self, neighbours: impl IntoIterator<Item = (Name, u32)>) {
        let own = self.own.identity.name();
        let usable = neighbours.into_iter().filter(|(name, _)| *name != own);
        let all: BTreeMap<Name, u32> = usable.map(|(name, cost)| (name, cost.max(1))).collect();
        self.own.has.neighbours = all.into_iter().take(MAX_NEIGHBOURS).collect();
    }

    /// Sets the neighbours whose daemons do not answer. Frames may go to them, control messages may
    /// not.
    pub fn set_silent(&mut self, silent: impl IntoIterator<Item = Name>) {
        self.own.has.silent = silent.into_iter().filter(|near| self.own.has.neighbours.contains_key(near)).collect();
    }

    /// Sets the usable links into other domains. At most [`MAX_BORDERS`] are stated.
    pub fn set_borders(&mut self, borders: impl IntoIterator<Item = Adjoining>) {
        let own = self.own.identity.name();
        let usable = borders.into_iter().filter(|border| border.switch != own);
        let all: BTreeMap<_, _> = usable
            .map(|border| ((border.domain, border.switch), Adjoining { cost: border.cost.max(1), ..border }))
            .collect();
        self.own.has.borders = all.into_iter().take(MAX_BORDERS).collect();
    }

    /// Sets whether the domain's RIB runs beside this switch.
    pub fn set_rib(&mut self, rib: bool) {
        self.own.has.rib = rib;
    }

    /// Sets the egress bit that the RIB assigned to this switch.
    pub fn set_bit(&mut self, bit: Option<u8>) {
        self.own.has.bit = bit;
    }

    /// Returns the egress bit of this switch, whether it is stated yet or not.
    pub fn bit(&self) -> Option<u8> {
        self.own.has.bit
    }

    /// Adds a link to a neighbouring switch, which is sent all statements.
    pub fn link_up(&mut self, link: u32) {
        self.flooding.up(link, self.database.switches());
    }

    pub fn link_down(&mut self, link: u32) {
        self.flooding.down(link);
    }

    /// Returns the received statements that may be newer than the stored ones. The caller verifies
    /// them and passes them to [`Self::learn`].
    pub fn news(&mut self, link: u32, states: Vec<Flooded>) -> Result<Vec<Flooded>, CertError> {
        let mut news = Vec::new();
        for flooded in states {
            let claims = flooded.state.claims_unverified()?;
            match self.database.compare(&flooded, &claims) {
                Ordering::Greater => news.push(flooded),
                Ordering::Equal => self.flooding.holds(link, &claims.switch),
                Ordering::Less => self.flooding.owe(link, claims.switch),
            }
        }
        Ok(news)
    }

    /// Stores verified statements received over a link and floods them over the others. Call
    /// [`Self::tick`] afterwards.
    pub fn learn(&mut self, now: Duration, link: u32, states: Vec<Verified>) {
        let own = self.own.identity.name();
        for Verified { flooded, claims } in states {
            let switch = claims.switch;
            if switch == own {
                self.own.received_own_state(&claims);
                continue;
            }
            match self.database.take(now, flooded, claims, |other| *other == own || self.paths.reaches(other)) {
                Taken::News { changed } => {
                    self.flooding.owe_all(switch);
                    self.flooding.holds(link, &switch);
                    self.is_stale |= changed;
                }
                Taken::Known => self.flooding.holds(link, &switch),
                Taken::Older => self.flooding.owe(link, switch),
                Taken::NoRoom => {
                    tracing::warn!(switch = %format_args!("{switch:#}"), "no room for what one more switch states");
                }
            }
        }
    }

    /// States this switch's links if due, removes expired statements and recomputes paths. Returns
    /// whether the paths or the nearest RIB changed.
    pub fn tick(&mut self, now: Duration) -> bool {
        self.is_stale |= self.database.expire(now);
        if self.own.next(now).is_some_and(|at| at <= now) {
            match self.own.state(now) {
                Ok((flooded, claims)) => {
                    let switch = claims.switch;
                    let taken = self.database.take(now, flooded, claims, |_| true);
                    self.is_stale |= taken == Taken::News { changed: true };
                    self.flooding.owe_all(switch);
                }
                Err(error) => tracing::error!(%error, "this switch cannot state its links"),
            }
        }
        if !std::mem::take(&mut self.is_stale) {
            return false;
        }
        let paths = Paths::compute(self.own.identity.name(), self.database.claims());
        let changed = paths != self.paths;
        self.paths = paths;
        changed
    }

    /// Returns the time at which [`Self::tick`] or [`Self::batches`] next have work, if nothing
    /// else happens before.
    pub fn next_tick(&self, now: Duration) -> Option<Duration> {
        let all = [self.own.next(now), self.database.next_expiry(), self.flooding.retry_at()];
        all.into_iter().flatten().min()
    }

    /// Returns the batches to send now. Each must be answered with [`Self::answered`].
    pub fn batches(&mut self, now: Duration) -> Vec<Batch> {
        self.flooding.next(now, &self.database)
    }

    /// Records whether a batch arrived. A lost batch is repeated later.
    pub fn answered(&mut self, now: Duration, batch: BatchId, arrived: bool) {
        self.flooding.answered(now, batch, arrived);
    }

    /// Returns the paths as of the last [`Self::tick`].
    pub fn paths(&self) -> &Paths {
        &self.paths
    }

    /// Returns the switch and the run of the nearest RIB that control messages reach, as of the
    /// last [`Self::tick`].
    pub fn rib(&self) -> Option<(Name, u64)> {
        self.paths.rib
    }

    /// Returns the border links of all reachable switches, including this one, each with its
    /// switch, as of the last [`Self::tick`].
    pub fn borders(&self) -> impl Iterator<Item = (Name, &Adjoining)> {
        let reached = self.states().filter(|state| self.paths.reaches(&state.switch));
        reached.flat_map(|state| state.borders.iter().map(|border| (state.switch, border)))
    }

    /// Returns the statements of all switches, including this one.
    pub fn states(&self) -> impl Iterator<Item = &LinkState> {
        self.database.claims()
    }
}

impl Own {
    /// Adopts the version of a statement by an earlier run, if it is not below the present one. The
    /// clock went back, or the number was lost.
    fn received_own_state(&mut self, older: &LinkState) {
        if older.version() >= self.version {
            self.version = older.version();
            self.stated = None;
        }
    }

    /// Returns the time of the next statement.
    fn next(&self, now: Duration) -> Option<Duration> {
        let Some(stated_at) = self.stated_at else { return Some(now) };
        let wait = match &self.stated {
            Some(stated) if self.has.lacks_one_of(stated) => MIN_INTERVAL,
            Some(stated) if *stated == self.has => REFRESH,
            _ => self.backoff.delay(),
        };
        Some(stated_at + wait)
    }

    fn state(&mut self, now: Duration) -> Result<(Flooded, LinkState), CertError> {
        match self.stated_at {
            Some(at) if now < at + self.backoff.delay() * 2 => _ = self.backoff.next_delay(),
            _ => self.backoff.reset(),
        }
        self.stated_at = Some(now);
        let (run, number) = match self.version {
            (run, u64::MAX) => (run.saturating_add(1), 1),
            (run, number) => (run, number + 1),
        };
        let is_silent = |(_, near): &(u32, &Name)| self.has.silent.contains(*near);
        let claims = LinkState {
            switch: self.identity.name(),
            run,
            number,
            bit: self.has.bit,
            neighbours: self.has.neighbours.iter().map(|(name, cost)| (*name, *cost)).collect(),
            silent: (0..).zip(self.has.neighbours.keys()).filter(is_silent).fold(0, |all, (i, _)| all | 1 << i),
            rib: self.has.rib,
            borders: self.has.borders.values().cloned().collect(),
            lifetime: LIFETIME,
        };
        let state = issue(self.identity.key(), &claims)?;
        self.version = (run, number);
        self.stated = Some(self.has.clone());
        Ok((Flooded { proof: self.identity.proof(), state, expires_in: LIFETIME }, claims))
    }
}
