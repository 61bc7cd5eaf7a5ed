//! The switches of the domain and the paths to them. Every switch floods its signed link state, and
//! each computes the shortest paths from all of these. The module is sans-IO: time, links and
//! messages go in; messages and masks come out. It does not need a RIB and does not use topic
//! names. `gdp-daemon` transports the messages. The RIB beside this switch reads which switches are
//! reachable.
//!
//! [`database`] stores the newest link state of each switch. [`flooding`] tracks which neighbour
//! lacks which link state. [`paths`] computes masks from link states, and [`cost`] computes the
//! cost of a link from its round-trip time.
//!
//! Every link state is verified before it gets here ([`Verified`]). A malicious switch can state
//! links that do not exist, so an adjacency counts only if both ends state it.

pub mod cost;
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
use gdp_wire::Name;

use database::{Database, Taken};
use flooding::Flooding;
pub use flooding::{Batch, BatchId};
pub use paths::Paths;

/// Lifetime of a link state, in seconds. A switch renews it after a third. The rest exceeds the
/// graceful-restart time of a dead daemon's links. So a switch that forwards without its daemon
/// stays in the topology.
pub const LIFETIME: u32 = 180;

const REFRESH: Duration = Duration::from_secs(LIFETIME as u64 / 3);

const _: () = assert!(LIFETIME as u64 * 2 / 3 > gdp_core::peer::GRACEFUL_RESTART_TIME.as_secs());

/// Minimum and maximum delay between two link states of this switch if its links change. The delay
/// doubles with each change that comes within twice its time. The first change after a quiet time
/// is sent at once. A lost neighbour is announced after the minimum delay, so that a flapping one
/// counts as lost.
const BACKOFF: (Duration, Duration) = (Duration::from_millis(50), Duration::from_secs(5));

/// A link state with a verified signature.
pub struct Verified {
    flooded: Flooded,
    claims: LinkState,
}

impl Verified {
    /// Verifies the signature of a link state. This takes some time but no lock.
    pub fn new(flooded: Flooded) -> Result<Self, CertError> {
        let claims = flooded.verify()?;
        Ok(Self { flooded, claims })
    }
}

/// The topology of the domain, as this switch knows it.
pub struct Topology {
    own: Own,
    database: Database,
    flooding: Flooding,
    paths: Paths,
    /// Whether the database has changed since the paths were computed.
    is_stale: bool,
}

/// The state that this switch announces about itself.
struct Own {
    identity: Identity,
    version: (u64, u64),
    has: Stated,
    /// The last announced state. `None` forces an announcement.
    stated: Option<Stated>,
    /// Time of the last announcement or attempt.
    stated_at: Option<Duration>,
    wait: Duration,
}

#[derive(Clone, Default, PartialEq, Eq)]
struct Stated {
    bit: Option<u8>,
    neighbours: BTreeMap<Name, u32>,
    silent: BTreeSet<Name>,
    rib: bool,
    /// The border links, by domain and switch.
    borders: BTreeMap<(Name, Name), Adjoining>,
}

impl Stated {
    /// Returns whether a neighbour or border of `before` is missing, or a neighbour has become
    /// silent.
    fn lacks_one_of(&self, before: &Self) -> bool {
        before.neighbours.keys().any(|near| !self.neighbours.contains_key(near))
            || !self.silent.is_subset(&before.silent)
            || before.borders.keys().any(|border| !self.borders.contains_key(border))
    }
}

impl Topology {
    /// Creates a topology. `run` must exceed that of this switch's last start. Otherwise the switch
    /// corrects it as soon as a neighbour sends back an old link state.
    pub fn new(identity: Identity, run: u64) -> Self {
        let own =
            Own { identity, version: (run, 0), has: Stated::default(), stated: None, stated_at: None, wait: BACKOFF.0 };
        let (database, flooding) = (Database::default(), Flooding::default());
        Self { own, database, flooding, paths: Paths::default(), is_stale: true }
    }

    /// Sets the neighbours that accept frames now, each with its cost. Those beyond
    /// [`MAX_NEIGHBOURS`] are not announced.
    pub fn set_neighbours(&mut self, neighbours: impl IntoIterator<Item = (Name, u32)>) {
        let own = self.own.identity.name();
        let usable = neighbours.into_iter().filter(|(name, _)| *name != own);
        let all: BTreeMap<Name, u32> = usable.map(|(name, cost)| (name, cost.max(1))).collect();
        self.own.has.neighbours = all.into_iter().take(MAX_NEIGHBOURS).collect();
    }

    /// Sets the neighbours whose daemons do not respond. They get frames, but no control messages.
    pub fn set_silent(&mut self, silent: impl IntoIterator<Item = Name>) {
        self.own.has.silent = silent.into_iter().filter(|near| self.own.has.neighbours.contains_key(near)).collect();
    }

    /// Sets the links into other domains that accept frames now. Those beyond [`MAX_BORDERS`] are
    /// not announced.
    pub fn set_borders(&mut self, borders: impl IntoIterator<Item = Adjoining>) {
        let own = self.own.identity.name();
        let usable = borders.into_iter().filter(|border| border.switch != own);
        let all: BTreeMap<_, _> = usable
            .map(|border| ((border.domain, border.switch), Adjoining { cost: border.cost.max(1), ..border }))
            .collect();
        self.own.has.borders = all.into_iter().take(MAX_BORDERS).collect();
    }

    /// Sets whether the domain's RIB is beside this switch.
    pub fn set_rib(&mut self, rib: bool) {
        self.own.has.rib = rib;
    }

    /// Sets the egress bit that the RIB has assigned to this switch.
    pub fn set_bit(&mut self, bit: Option<u8>) {
        self.own.has.bit = bit;
    }

    /// Returns the egress bit of this switch, even if it is not announced yet.
    pub fn bit(&self) -> Option<u8> {
        self.own.has.bit
    }

    /// Adds a link to a neighbouring switch, which receives all link states.
    pub fn link_up(&mut self, link: u32) {
        self.flooding.up(link, self.database.switches());
    }

    pub fn link_down(&mut self, link: u32) {
        self.flooding.down(link);
    }

    /// Returns those of the received link states that may be new. The caller must verify them and
    /// pass them to [`Self::learn`].
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

    /// Stores link states received over a link, and floods them over the other links. Call
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

    /// Announces this switch's link state if it is due, removes expired ones, and computes the
    /// paths. Returns whether the paths or the RIB changed.
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

    /// Returns when [`Self::tick`] or [`Self::batches`] must run next if nothing else happens.
    pub fn next_tick(&self, now: Duration) -> Option<Duration> {
        let all = [self.own.next(now), self.database.next_expiry(), self.flooding.retry_at()];
        all.into_iter().flatten().min()
    }

    /// Returns the batches to send now. The caller must report the result of each to
    /// [`Self::answered`].
    pub fn batches(&mut self, now: Duration) -> Vec<Batch> {
        self.flooding.next(now, &self.database)
    }

    /// Records whether a batch arrived. A lost batch is sent again after a backoff.
    pub fn answered(&mut self, now: Duration, batch: BatchId, arrived: bool) {
        self.flooding.answered(now, batch, arrived);
    }

    /// Returns the paths as of the last [`Self::tick`].
    pub fn paths(&self) -> &Paths {
        &self.paths
    }

    /// Returns the switch of the nearest RIB that control messages can reach, and its run. The
    /// value is as of the last [`Self::tick`].
    pub fn rib(&self) -> Option<(Name, u64)> {
        self.paths.rib
    }

    /// Returns the links into other domains of all reachable switches, each with its switch. The
    /// value is as of the last [`Self::tick`].
    pub fn borders(&self) -> impl Iterator<Item = (Name, &Adjoining)> {
        let reached = self.states().filter(|state| self.paths.reaches(&state.switch));
        reached.flat_map(|state| state.borders.iter().map(|border| (state.switch, border)))
    }

    /// Returns the link states of all switches, including this one.
    pub fn states(&self) -> impl Iterator<Item = &LinkState> {
        self.database.claims()
    }
}

impl Own {
    /// Handles a link state of this switch that an earlier run signed. If its version is not lower
    /// than the current one, the clock went back or the number was lost.
    fn received_own_state(&mut self, older: &LinkState) {
        if older.version() >= self.version {
            self.version = older.version();
            self.stated = None;
        }
    }

    /// Returns when the next announcement is due.
    fn next(&self, now: Duration) -> Option<Duration> {
        let Some(stated_at) = self.stated_at else { return Some(now) };
        let wait = match &self.stated {
            Some(stated) if self.has.lacks_one_of(stated) => BACKOFF.0,
            Some(stated) if *stated == self.has => REFRESH,
            _ => self.wait,
        };
        Some(stated_at + wait)
    }

    fn state(&mut self, now: Duration) -> Result<(Flooded, LinkState), CertError> {
        let recent = self.stated_at.is_some_and(|at| now < at + self.wait * 2);
        self.wait = if recent { (self.wait * 2).min(BACKOFF.1) } else { BACKOFF.0 };
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
