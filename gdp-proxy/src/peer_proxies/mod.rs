//! Proxies in one ROS graph that could carry the same: each tells the others what it is able to
//! carry, and of those that are able the one with the lowest name does. The others stand by, and
//! take over once it has gone, has lost the fabric or its right, or is silent for
//! [`DEAD_INTERVAL`].
//! Services and actions stay with the one that carries them, though a lower name comes: with it,
//! calls and goals that are under way would end.
//!
//! Nobody in a ROS graph is authenticated: who is in it can have a proxy stand by, as it can
//! publish whatever it likes there.

mod beat;

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use gdp_wire::Name;
use parking_lot::{Mutex, MutexGuard};
use serde::{Deserialize, Serialize};
use tokio::sync::Notify;

pub use beat::{Voice, beat};

use crate::config::{MAX_CALLS, MAX_ROUTES, Side};

/// For how long another proxy is taken for there that is not heard of: three times as long as it is
/// silent at most.
pub const DEAD_INTERVAL: Duration = Duration::from_secs(3);

/// For how long it is listened, before calls are taken, whether another proxy takes them: longer
/// than one is silent.
pub const LISTEN: Duration = Duration::from_millis(1500);

/// Other proxies in a graph; what more there are is not heeded.
const MAX_OTHERS: usize = 64;

/// Of one proxy.
const MAX_PARTS: usize = MAX_ROUTES + MAX_CALLS;

const VERSION: u8 = 2;

/// What only one proxy of a graph carries: a topic, a service or an action of the graph, under one
/// name, one way.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RoutePart {
    pub name: Name,
    pub side: Side,
    /// `topic /chatter`, `service /add`, `action /move`.
    pub title: String,
}

/// What a proxy tells the others.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Claims {
    version: u8,
    entity: Name,
    /// What it is able to carry, and whether that stays with it because it does.
    able: Vec<(RoutePart, bool)>,
}

/// Of any version.
#[derive(Deserialize)]
struct Versioned {
    version: u8,
}

/// The proxies of one graph.
#[derive(Default)]
pub struct PeerProxies {
    state: Mutex<State>,
    /// There is something new to tell.
    news: Notify,
}

#[derive(Default)]
struct State {
    /// Known once there is something to carry.
    own: Option<Name>,
    able: HashMap<RoutePart, Able>,
    others: HashMap<Name, Other>,
}

/// Whether this proxy can carry a part.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Able {
    is_attached: bool,
    is_permitted: bool,
    /// It does, and keeps it.
    keeps: bool,
}

struct Other {
    /// And whether it keeps that.
    able: HashMap<RoutePart, bool>,
    last_seen: Instant,
}

/// What one route carries or stands by for, until it is dropped.
pub struct Candidate {
    peer_proxies: Arc<PeerProxies>,
    own: Name,
    part: RoutePart,
}

/// What another proxy says is not taken.
#[derive(Debug, thiserror::Error)]
pub enum ClaimsError {
    #[error("it is not understood: {0}")]
    Json(#[from] serde_json::Error),
    #[error("it is of version {0}, which this release does not know; update the proxies")]
    Version(u8),
    #[error("{what}: {got} where at most {most} are allowed")]
    TooMuch { what: &'static str, got: usize, most: usize },
}

impl PeerProxies {
    /// For the proxy `own`. `is_able`: whether it is taken to be able to carry it, until it says
    /// otherwise.
    pub fn enter(self: &Arc<Self>, own: Name, part: RoutePart, is_able: bool) -> Candidate {
        let mut state = self.lock();
        state.own = Some(own);
        state.able.insert(part.clone(), Able { is_attached: true, is_permitted: is_able, keeps: false });
        self.news.notify_one();
        Candidate { peer_proxies: self.clone(), own, part }
    }

    /// What the others are to be told, if there has ever been something.
    pub fn claims(&self) -> Option<String> {
        let state = self.lock();
        let able = state
            .able
            .iter()
            .filter(|(_, able)| able.is_able())
            .map(|(part, able)| (part.clone(), able.keeps))
            .collect();
        serde_json::to_string(&Claims { version: VERSION, entity: state.own?, able }).ok()
    }

    /// Another proxy, or this one, has told this.
    pub fn receive(&self, now: Instant, text: &str) -> Result<(), ClaimsError> {
        let Versioned { version } = serde_json::from_str(text)?;
        if version != VERSION {
            return Err(ClaimsError::Version(version));
        }
        let Claims { entity, able, .. } = serde_json::from_str(text)?;
        if able.len() > MAX_PARTS {
            return Err(ClaimsError::TooMuch { what: "parts", got: able.len(), most: MAX_PARTS });
        }
        let mut state = self.lock();
        if state.own == Some(entity) {
            return Ok(());
        }
        state.others.retain(|_, other| other.is_there(now));
        if state.others.len() >= MAX_OTHERS && !state.others.contains_key(&entity) {
            return Err(ClaimsError::TooMuch { what: "proxies in a graph", got: MAX_OTHERS + 1, most: MAX_OTHERS });
        }
        let known = state.others.insert(entity, Other { able: able.into_iter().collect(), last_seen: now });
        if known.is_none() {
            // One who comes is not to wait for the next time that it is told.
            self.news.notify_one();
        }
        Ok(())
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock()
    }
}

impl Able {
    fn is_able(self) -> bool {
        self.is_attached && self.is_permitted
    }
}

impl Other {
    fn is_there(&self, now: Instant) -> bool {
        now.saturating_duration_since(self.last_seen) < DEAD_INTERVAL
    }
}

impl Candidate {
    /// Whether this proxy reaches the fabric.
    pub fn set_attached(&self, is_attached: bool) {
        self.set(|able| able.is_attached = is_attached);
    }

    /// Whether the fabric lets this proxy carry it, and the graph and the types that it knows do.
    pub fn set_permitted(&self, is_permitted: bool) {
        self.set(|able| able.is_permitted = is_permitted);
    }

    /// Whether this proxy carries it, and goes on with that whoever comes: said of services and
    /// actions alone.
    pub fn set_keeps(&self, keeps: bool) {
        self.set(|able| able.keeps = keeps);
    }

    fn set(&self, change: impl FnOnce(&mut Able)) {
        let mut state = self.peer_proxies.lock();
        let Some(able) = state.able.get_mut(&self.part) else { return };
        let before = *able;
        change(able);
        if *able != before {
            self.peer_proxies.news.notify_one();
        }
    }

    /// Who carries it instead of this proxy.
    pub fn ahead(&self, now: Instant) -> Option<Name> {
        let state = self.peer_proxies.lock();
        let own = state.able.get(&self.part).is_some_and(|able| able.is_able() && able.keeps);
        let others = state.others.iter().filter(|(_, other)| other.is_there(now));
        let others = others.filter_map(|(name, other)| Some((*name, *other.able.get(&self.part)?)));
        let ahead = others.filter(|(name, theirs)| match own {
            // Both began before they had heard of each other.
            true => *theirs && *name < self.own,
            false => *theirs || *name < self.own,
        });
        ahead.map(|(name, _)| name).min()
    }

    /// Whether what this entity publishes under the name is from the same graph.
    pub fn is_twin(&self, now: Instant, entity: &Name) -> bool {
        let state = self.peer_proxies.lock();
        let publishes = |part: &RoutePart| part.side == Side::Out && part.name == self.part.name;
        state.others.get(entity).is_some_and(|other| other.is_there(now) && other.able.keys().any(publishes))
    }
}

impl Drop for Candidate {
    fn drop(&mut self) {
        self.peer_proxies.lock().able.remove(&self.part);
        self.peer_proxies.news.notify_one();
    }
}

#[cfg(test)]
#[path = "../../tests/unit/peer_proxies.rs"]
mod tests;
