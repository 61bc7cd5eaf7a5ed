//! Proxies in one ROS graph that could carry the same: each tells the others what it is able to carry, and of those that are able the one with the
//! lowest name does. The others stand by, and take over once it has gone, has lost the fabric or its right, or is not heard of for [`HOLD`].
//! Services and actions stay with the one that carries them, though a lower name comes: with it, calls and goals that are under way would end.
//!
//! Nobody in a ROS graph is authenticated: who is in it can have a proxy stand by, as it can publish whatever it likes there.

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

/// For how long another proxy is taken for there that is not heard of: three times as long as it is silent at most.
pub const HOLD: Duration = Duration::from_secs(3);

/// For how long it is listened, before calls are taken, whether another proxy takes them: longer than one is silent.
pub const LISTEN: Duration = Duration::from_millis(1500);

/// Other proxies in a graph; what more there are is not heeded.
const MAX_OTHERS: usize = 64;

/// Of one proxy.
const MAX_PARTS: usize = MAX_ROUTES + MAX_CALLS;

const VERSION: u8 = 2;

/// What only one proxy of a graph carries: a topic, a service or an action of the graph, under one name, one way.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Part {
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
    able: Vec<(Part, bool)>,
}

/// Of any version.
#[derive(Deserialize)]
struct Versioned {
    version: u8,
}

/// The proxies of one graph.
#[derive(Default)]
pub struct Twins {
    state: Mutex<State>,
    /// There is something new to tell.
    news: Notify,
}

#[derive(Default)]
struct State {
    /// Known once there is something to carry.
    own: Option<Name>,
    able: HashMap<Part, Able>,
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
    able: HashMap<Part, bool>,
    heard: Instant,
}

/// What one route carries or stands by for, until it is dropped.
pub struct Place {
    twins: Arc<Twins>,
    own: Name,
    part: Part,
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

impl Twins {
    /// For the proxy `own`. `is_able`: whether it is taken to be able to carry it, until it says otherwise.
    pub fn enter(self: &Arc<Self>, own: Name, part: Part, is_able: bool) -> Place {
        let mut state = self.lock();
        state.own = Some(own);
        state.able.insert(part.clone(), Able { is_attached: true, is_permitted: is_able, keeps: false });
        self.news.notify_one();
        Place { twins: self.clone(), own, part }
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
    pub fn heard(&self, now: Instant, text: &str) -> Result<(), ClaimsError> {
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
        let known = state.others.insert(entity, Other { able: able.into_iter().collect(), heard: now });
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
        now.saturating_duration_since(self.heard) < HOLD
    }
}

impl Place {
    /// Whether this proxy reaches the fabric.
    pub fn set_attached(&self, is_attached: bool) {
        self.set(|able| able.is_attached = is_attached);
    }

    /// Whether the fabric lets this proxy carry it, and the graph and the types that it knows do.
    pub fn set_permitted(&self, is_permitted: bool) {
        self.set(|able| able.is_permitted = is_permitted);
    }

    /// Whether this proxy carries it, and goes on with that whoever comes: said of services and actions alone.
    pub fn set_keeps(&self, keeps: bool) {
        self.set(|able| able.keeps = keeps);
    }

    fn set(&self, change: impl FnOnce(&mut Able)) {
        let mut state = self.twins.lock();
        let Some(able) = state.able.get_mut(&self.part) else { return };
        let before = *able;
        change(able);
        if *able != before {
            self.twins.news.notify_one();
        }
    }

    /// Who carries it instead of this proxy.
    pub fn ahead(&self, now: Instant) -> Option<Name> {
        let state = self.twins.lock();
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
        let state = self.twins.lock();
        let publishes = |part: &Part| part.side == Side::Out && part.name == self.part.name;
        state.others.get(entity).is_some_and(|other| other.is_there(now) && other.able.keys().any(publishes))
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.twins.lock().able.remove(&self.part);
        self.twins.news.notify_one();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lowest_that_is_able_carries() {
        let now = Instant::now();
        let [low, mid, high] = [1, 2, 3].map(|i| (Arc::new(Twins::default()), Name::from_bytes([i; 32])));
        let tell = |now| {
            for (from, _) in [&low, &mid, &high] {
                let Some(text) = from.claims() else { continue };
                [&low, &mid, &high].iter().for_each(|(to, _)| to.heard(now, &text).unwrap());
            }
        };
        let place = |of: &(Arc<Twins>, Name), part: Part| of.0.enter(of.1, part, true);
        let (b, c) = (place(&mid, part(Side::Out)), place(&high, part(Side::Out)));
        assert_eq!((b.ahead(now), c.ahead(now)), (None, None), "nobody is waited for");
        tell(now);
        assert_eq!((b.ahead(now), c.ahead(now)), (None, Some(mid.1)));
        let a = place(&low, part(Side::Out));
        tell(now);
        assert_eq!((a.ahead(now), b.ahead(now), c.ahead(now)), (None, Some(low.1), Some(low.1)));
        a.set_attached(false);
        tell(now);
        assert_eq!((b.ahead(now), c.ahead(now)), (None, Some(mid.1)));
        drop(b);
        tell(now);
        assert_eq!(c.ahead(now), None);
        a.set_attached(true);
        tell(now);
        assert_eq!((c.ahead(now), c.ahead(now + HOLD)), (Some(low.1), None), "not heard of any more");
        // Back after it could not, and not shown yet that it can.
        drop(a);
        let a = low.0.enter(low.1, part(Side::Out), false);
        tell(now);
        assert_eq!(c.ahead(now), None);
        a.set_permitted(true);
        tell(now);
        assert_eq!(c.ahead(now), Some(low.1));
    }

    #[test]
    fn what_is_kept_stays_with_who_has_it_and_of_two_that_have_it_the_lowest_goes_on() {
        let now = Instant::now();
        let [low, high] = [1, 2].map(|i| (Arc::new(Twins::default()), Name::from_bytes([i; 32])));
        let tell = |from: &(Arc<Twins>, Name), to: &(Arc<Twins>, Name)| {
            to.0.heard(now, &from.0.claims().unwrap()).unwrap();
        };
        let [a, b] = [&low, &high].map(|of| of.0.enter(of.1, part(Side::In), true));
        b.set_keeps(true);
        tell(&high, &low);
        tell(&low, &high);
        assert_eq!((a.ahead(now), b.ahead(now)), (Some(high.1), None), "the one that has it");
        b.set_attached(false);
        tell(&high, &low);
        assert_eq!(a.ahead(now), None, "it cannot any more");
        a.set_keeps(true);
        tell(&low, &high);
        assert_eq!(b.ahead(now), Some(low.1));
        b.set_attached(true);
        tell(&high, &low);
        assert_eq!((a.ahead(now), b.ahead(now)), (None, Some(low.1)), "both have it");
    }

    #[test]
    fn another_kind_or_direction_is_another_part() {
        let (now, [low, high]) = (Instant::now(), [1, 2].map(|i| Name::from_bytes([i; 32])));
        let (here, there) = (Arc::new(Twins::default()), Arc::new(Twins::default()));
        let _theirs = there.enter(low, part(Side::Out), true);
        let ours = here.enter(high, part(Side::In), true);
        let other = here.enter(high, Part { title: "service /chatter".into(), ..part(Side::Out) }, true);
        here.heard(now, &there.claims().unwrap()).unwrap();
        assert_eq!((ours.ahead(now), other.ahead(now)), (None, None));
        assert!(ours.is_twin(now, &low) && !ours.is_twin(now, &high) && !ours.is_twin(now + HOLD, &low));
    }

    #[test]
    fn what_others_say_is_bounded() {
        let (now, twins) = (Instant::now(), Twins::default());
        let claims = |entity: u8, version, parts: usize| {
            let able = (0..parts).map(|i| (Part { title: format!("topic /{i}"), ..part(Side::In) }, false)).collect();
            serde_json::to_string(&Claims { version, entity: Name::from_bytes([entity; 32]), able }).unwrap()
        };
        let refused = |text: &str| twins.heard(now, text).unwrap_err().to_string();
        assert!(refused("{}").contains("not understood"));
        assert!(refused(r#"{"version":1,"entity":"x","able":["y"]}"#).contains("version 1"));
        assert!(refused(&claims(1, 3, 0)).contains("version 3"));
        assert!(refused(&claims(1, 2, MAX_PARTS + 1)).contains(&format!("parts: {}", MAX_PARTS + 1)));
        (0..MAX_OTHERS as u8).for_each(|i| twins.heard(now, &claims(i, 2, 1)).unwrap());
        assert!(refused(&claims(99, 2, 1)).contains("proxies in a graph: 65"));
        twins.heard(now + HOLD, &claims(99, 2, 1)).unwrap();
    }

    fn part(side: Side) -> Part {
        Part { name: Name::from_bytes([9; 32]), side, title: "topic /chatter".into() }
    }
}
