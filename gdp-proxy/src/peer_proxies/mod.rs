//! Coordinates the proxies of one ROS graph that could carry the same routes. Each proxy announces
//! what it can carry. The one with the lowest name carries it. The others stand by, and take over
//! once that proxy has left, has lost the fabric or its certificate, or is silent for
//! [`DEAD_INTERVAL`]. A service or action stays with the proxy that carries it, although a lower
//! name appears: otherwise its calls and goals in progress would end.
//!
//! A ROS graph authenticates nobody. A node in it can make a proxy stand by, as it can publish
//! anything there.

mod beat;

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use gdp_wire::Name;
use parking_lot::{Mutex, MutexGuard};
use serde::{Deserialize, Serialize};
use tokio::sync::{Notify, watch};

pub use beat::{Voice, beat};

use crate::config::{MAX_CALLS, MAX_ROUTES, Side};

/// Time without an announcement after which another proxy counts as gone: three times the longest
/// silence of a proxy.
pub const DEAD_INTERVAL: Duration = Duration::from_secs(3);

/// Time for which a proxy listens for other proxies before it accepts calls: longer than the
/// longest silence of a proxy.
pub const LISTEN: Duration = Duration::from_millis(1500);

/// Bound on the number of other proxies in a graph. Further ones are ignored.
const MAX_OTHERS: usize = 64;

/// Bound on the number of parts of one proxy.
const MAX_PARTS: usize = MAX_ROUTES + MAX_CALLS;

const VERSION: u8 = 2;

/// A topic, service or action of the graph under one name in one direction. Only one proxy of a
/// graph carries it.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RoutePart {
    pub name: Name,
    pub side: Side,
    /// Kind and ROS name: `topic /chatter`, `service /add`, `action /move`.
    pub title: String,
}

/// The announcement of a proxy to the others.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Claims {
    version: u8,
    entity: Name,
    /// The parts that the proxy can carry, each with whether the proxy carries and keeps it.
    able: Vec<(RoutePart, bool)>,
}

/// The version field of a claim of any version.
#[derive(Deserialize)]
struct Versioned {
    version: u8,
}

/// The proxies of one graph and what each can carry.
#[derive(Default)]
pub struct PeerProxies {
    state: Mutex<State>,
    /// Notified when this proxy's claims change.
    news: Notify,
    /// Notified when those of another proxy change.
    changes: watch::Sender<()>,
}

#[derive(Default)]
struct State {
    /// Known once there is something to carry.
    own: Option<Name>,
    able: HashMap<RoutePart, Able>,
    others: HashMap<Name, Other>,
}

/// Conditions under which this proxy carries a part.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Able {
    is_attached: bool,
    is_permitted: bool,
    /// True if the proxy carries the part and keeps it.
    keeps: bool,
}

struct Other {
    /// The parts that the proxy can carry, each with whether it keeps the part.
    able: HashMap<RoutePart, bool>,
    last_seen: Instant,
}

/// The candidacy of this proxy for one part, which ends when it is dropped.
pub struct Candidate {
    peer_proxies: Arc<PeerProxies>,
    own: Name,
    part: RoutePart,
}

/// The proxies of the same graph that publish one name.
pub struct SiblingProxies {
    peer_proxies: Arc<PeerProxies>,
    name: Name,
}

/// Errors in the announcement of another proxy.
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
    /// Enters the proxy `own` as a candidate for `part`. `is_able` is whether it can carry the
    /// part, until [`Candidate::set_permitted`] changes that.
    pub fn enter(self: &Arc<Self>, own: Name, part: RoutePart, is_able: bool) -> Candidate {
        let mut state = self.lock();
        state.own = Some(own);
        state.able.insert(part.clone(), Able { is_attached: true, is_permitted: is_able, keeps: false });
        self.news.notify_one();
        Candidate { peer_proxies: self.clone(), own, part }
    }

    /// Returns the announcement of this proxy, or `None` if it has never been a candidate.
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

    /// Receives an announcement of another proxy. It ignores its own.
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
        let able = able.into_iter().collect();
        if state.others.get(&entity).is_none_or(|other| other.able != able) {
            self.changes.send_replace(());
        }
        let known = state.others.insert(entity, Other { able, last_seen: now });
        if known.is_none() {
            // A proxy that joins gets an answer before the next period.
            self.news.notify_one();
        }
        Ok(())
    }

    /// Whether no other proxy of the graph is known.
    fn is_alone(&self, now: Instant) -> bool {
        !self.lock().others.values().any(|other| other.is_there(now))
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
    /// Sets whether this proxy is attached to the fabric.
    pub fn set_attached(&self, is_attached: bool) {
        self.set(|able| able.is_attached = is_attached);
    }

    /// Sets whether the fabric permits this proxy to carry the part, and the graph and the known
    /// types allow it.
    pub fn set_permitted(&self, is_permitted: bool) {
        self.set(|able| able.is_permitted = is_permitted);
    }

    /// Sets whether this proxy carries the part and keeps it when a proxy with a lower name
    /// appears. Only services and actions are kept.
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

    /// Returns the changes of what other proxies announce.
    pub fn changes(&self) -> Changes {
        Changes(self.peer_proxies.changes.subscribe())
    }

    /// Returns the proxy that carries the part instead of this one, if any.
    pub fn ahead(&self, now: Instant) -> Option<Name> {
        let state = self.peer_proxies.lock();
        let own = state.able.get(&self.part).is_some_and(|able| able.is_able() && able.keeps);
        let others = state.others.iter().filter(|(_, other)| other.is_there(now));
        let others = others.filter_map(|(name, other)| Some((*name, *other.able.get(&self.part)?)));
        let ahead = others.filter(|(name, theirs)| match own {
            // Both proxies began before they received each other's announcement.
            true => *theirs && *name < self.own,
            false => *theirs || *name < self.own,
        });
        ahead.map(|(name, _)| name).min()
    }

    /// Whether `entity` publishes the name from the same graph.
    pub fn is_twin(&self, now: Instant, entity: &Name) -> bool {
        self.siblings().contain(now, entity)
    }

    /// Returns the siblings of this proxy: those that publish the name from the same graph.
    pub fn siblings(&self) -> SiblingProxies {
        SiblingProxies { peer_proxies: self.peer_proxies.clone(), name: self.part.name }
    }
}

impl SiblingProxies {
    pub fn contain(&self, now: Instant, entity: &Name) -> bool {
        let state = self.peer_proxies.lock();
        let publishes = |part: &RoutePart| part.side == Side::Out && part.name == self.name;
        state.others.get(entity).is_some_and(|other| other.is_there(now) && other.able.keys().any(publishes))
    }
}

/// The changes of what the other proxies of a graph announce, since it was created.
pub struct Changes(watch::Receiver<()>);

impl Changes {
    /// Waits for the next change. Safe to cancel.
    pub async fn next(&mut self) {
        if self.0.changed().await.is_err() {
            // The graph was left.
            std::future::pending::<()>().await;
        }
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
