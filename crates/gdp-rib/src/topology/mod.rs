//! Which switches there are in the domain and which paths lead to them: what every switch states of
//! its links, flooded between the switches, and the shortest paths that this switch computes from
//! it. Sans-IO: time, links and messages go in; messages and masks come out. Needs no RIB, and
//! knows nothing of names of topics; `gdp-daemon` moves what travels, and the RIB beside
//! this switch reads which switches are reached.
//!
//! [`database`] holds the newest statement of each switch, [`flooding`] knows which neighbour lacks
//! which, [`paths`] turns statements into masks, [`cost`] a round-trip time into what crossing a
//! link costs.
//!
//! Every statement is verified before it gets here ([`Verified`]). What a switch that lies can do
//! is to state links that it has not: an adjacency counts only if both ends state it.

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

/// Seconds that a statement holds; it is stated again after a third of it. What is left then
/// outlives the time for which the links of a daemon that died are held, so a switch that forwards
/// on without its daemon stays on the map.
pub const LIFETIME: u32 = 180;

const REFRESH: Duration = Duration::from_secs(LIFETIME as u64 / 3);

const _: () = assert!(LIFETIME as u64 * 2 / 3 > gdp_core::peer::GRACEFUL_RESTART_TIME.as_secs());

/// Between two statements of this switch, if what it states changes: from the first to the second,
/// doubled with each that comes within twice the time. The first change after a quiet time is
/// stated at once; that a neighbour is gone always after the first time, so what flaps is stated as
/// gone rather than as there.
const BACKOFF: (Duration, Duration) = (Duration::from_millis(50), Duration::from_secs(5));

/// A statement that its switch has signed.
pub struct Verified {
    flooded: Flooded,
    claims: LinkState,
}

impl Verified {
    /// Takes no lock and some time: a signature is verified.
    pub fn new(flooded: Flooded) -> Result<Self, CertError> {
        let claims = flooded.verify()?;
        Ok(Self { flooded, claims })
    }
}

/// What this switch knows of the domain's switches.
pub struct Topology {
    own: Own,
    database: Database,
    flooding: Flooding,
    paths: Paths,
    /// The paths do not follow from what is in the database yet.
    is_stale: bool,
}

/// What this switch is to state of itself, and what it has.
struct Own {
    identity: Identity,
    version: (u64, u64),
    has: Stated,
    /// What it last stated; none: it is to be stated whatever it has.
    stated: Option<Stated>,
    /// When it last did, or tried.
    stated_at: Option<Duration>,
    wait: Duration,
}

#[derive(Clone, Default, PartialEq, Eq)]
struct Stated {
    bit: Option<u8>,
    neighbours: BTreeMap<Name, u32>,
    silent: BTreeSet<Name>,
    rib: bool,
    /// By domain and switch.
    borders: BTreeMap<(Name, Name), Adjoining>,
}

impl Stated {
    /// Whether somebody who was there is not any more, or does not answer.
    fn lacks_one_of(&self, before: &Self) -> bool {
        before.neighbours.keys().any(|near| !self.neighbours.contains_key(near))
            || !self.silent.is_subset(&before.silent)
            || before.borders.keys().any(|border| !self.borders.contains_key(border))
    }
}

impl Topology {
    /// `run`: higher than that of this switch's last start. If it is not, the switch finds out as
    /// soon as a neighbour tells it.
    pub fn new(identity: Identity, run: u64) -> Self {
        let own =
            Own { identity, version: (run, 0), has: Stated::default(), stated: None, stated_at: None, wait: BACKOFF.0 };
        let (database, flooding) = (Database::default(), Flooding::default());
        Self { own, database, flooding, paths: Paths::default(), is_stale: true }
    }

    /// The neighbours that frames may go to now, and what that costs. Those beyond
    /// [`MAX_NEIGHBOURS`] are not stated.
    pub fn set_neighbours(&mut self, neighbours: impl IntoIterator<Item = (Name, u32)>) {
        let own = self.own.identity.name();
        let usable = neighbours.into_iter().filter(|(name, _)| *name != own);
        let all: BTreeMap<Name, u32> = usable.map(|(name, cost)| (name, cost.max(1))).collect();
        self.own.has.neighbours = all.into_iter().take(MAX_NEIGHBOURS).collect();
    }

    /// Those of the neighbours whose daemons do not answer, so that nothing but frames may go to
    /// them.
    pub fn set_silent(&mut self, silent: impl IntoIterator<Item = Name>) {
        self.own.has.silent = silent.into_iter().filter(|near| self.own.has.neighbours.contains_key(near)).collect();
    }

    /// The links into other domains that frames may go by now. Those beyond [`MAX_BORDERS`] are not
    /// stated.
    pub fn set_borders(&mut self, borders: impl IntoIterator<Item = Adjoining>) {
        let own = self.own.identity.name();
        let usable = borders.into_iter().filter(|border| border.switch != own);
        let all: BTreeMap<_, _> = usable
            .map(|border| ((border.domain, border.switch), Adjoining { cost: border.cost.max(1), ..border }))
            .collect();
        self.own.has.borders = all.into_iter().take(MAX_BORDERS).collect();
    }

    /// Whether the domain's RIB is beside this switch.
    pub fn set_rib(&mut self, rib: bool) {
        self.own.has.rib = rib;
    }

    /// The egress bit that the RIB has given this switch.
    pub fn set_bit(&mut self, bit: Option<u8>) {
        self.own.has.bit = bit;
    }

    /// The bit that this switch has, whether or not it has stated it.
    pub fn bit(&self) -> Option<u8> {
        self.own.has.bit
    }

    /// A link to a neighbouring switch is up: it is told all there is.
    pub fn link_up(&mut self, link: u32) {
        self.flooding.up(link, self.database.switches());
    }

    pub fn link_down(&mut self, link: u32) {
        self.flooding.down(link);
    }

    /// Those of the statements that came over a link that may be news. They are to be verified, and
    /// then [learnt](Self::learn).
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

    /// Takes in statements that came over a link, and passes them on over the others. Follow with
    /// [`Self::tick`].
    pub fn learn(&mut self, now: Duration, link: u32, states: Vec<Verified>) {
        let own = self.own.identity.name();
        for Verified { flooded, claims } in states {
            let switch = claims.switch;
            if switch == own {
                self.own.heard_of_itself(&claims);
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

    /// Brings everything up to date: states what this switch has to state, lets end what is over,
    /// computes paths. Returns whether there are other paths than before, or another RIB.
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

    /// When [`Self::tick`] or [`Self::batches`] have something to do, if nothing else happens
    /// before.
    pub fn next_tick(&self, now: Duration) -> Option<Duration> {
        let all = [self.own.next(now), self.database.next_expiry(), self.flooding.retry_at()];
        all.into_iter().flatten().min()
    }

    /// Takes out what is to be sent now. Each is to be answered with [`Self::answered`].
    pub fn batches(&mut self, now: Duration) -> Vec<Batch> {
        self.flooding.next(now, &self.database)
    }

    /// Whether a batch arrived; if not, it is sent again a while later.
    pub fn answered(&mut self, now: Duration, batch: BatchId, arrived: bool) {
        self.flooding.answered(now, batch, arrived);
    }

    /// As of the last [`Self::tick`].
    pub fn paths(&self) -> &Paths {
        &self.paths
    }

    /// The nearest RIB that control reaches: its switch, and which run of it; as of the last
    /// [`Self::tick`].
    pub fn rib(&self) -> Option<(Name, u64)> {
        self.paths.rib
    }

    /// The links of all switches that are reached into other domains, this one's among them, each
    /// with its switch; as of the last [`Self::tick`].
    pub fn borders(&self) -> impl Iterator<Item = (Name, &Adjoining)> {
        let reached = self.states().filter(|state| self.paths.reaches(&state.switch));
        reached.flat_map(|state| state.borders.iter().map(|border| (state.switch, border)))
    }

    /// What each switch states, this one among them.
    pub fn states(&self) -> impl Iterator<Item = &LinkState> {
        self.database.claims()
    }
}

impl Own {
    /// An older self has stated something under a higher version: the clock went back, or the
    /// number was lost.
    fn heard_of_itself(&mut self, older: &LinkState) {
        if older.version() >= self.version {
            self.version = older.version();
            self.stated = None;
        }
    }

    /// When the next statement is to be made.
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
