//! Selects the entities of a graph that are exposed. The configuration selects them by pattern. An
//! entity stays exposed while a node publishes or serves it, and a little longer.

use std::collections::BTreeMap;
use std::fmt;
use std::time::{Duration, Instant};

use crate::config::{ExposeConfig, RuleOptions, Thing, What, action_of_topic, is_hidden, remapped};
use crate::graph::{Found, Offered};
use crate::ros2::{TopicName, TypeName};

/// Time for which an entity stays exposed without a publisher or server. A restarted node is back
/// by then.
pub const GRACE: Duration = Duration::from_secs(5);

/// The remote name and the options of an exposed entity.
#[derive(Clone, Debug, PartialEq)]
pub struct Exposed {
    /// Its name outside of this graph.
    pub name: TopicName,
    pub rule_options: RuleOptions,
}

/// Reasons for which an entity is not exposed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NotExposed {
    Denied(String),
    Hidden(Thing),
    NoPattern(Thing),
    OtherType,
    /// A topic of an action of ROS 1, which is exposed as an action.
    OfAction(TopicName),
    /// Its name after `remap` would be too long.
    NoName,
}

impl fmt::Display for NotExposed {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Denied(pattern) => write!(f, "deny has {pattern}"),
            Self::Hidden(thing) => {
                let list = thing.list();
                write!(f, "ROS or the proxy has it for itself: only its own name under {list} exposes it")
            }
            Self::NoPattern(thing) => write!(f, "no pattern under {} matches", thing.list()),
            Self::OtherType => f.write_str("its type is not one of types"),
            Self::OfAction(action) => write!(f, "the action {action} has it, and actions has a pattern for that"),
            Self::NoName => f.write_str("its name after remap would be too long"),
        }
    }
}

/// Checks whether the configuration exposes an entity of this type, and how.
pub fn check_exposed(
    config: &ExposeConfig,
    thing: Thing,
    name: &TopicName,
    kind: Option<&TypeName>,
) -> Result<Exposed, NotExposed> {
    if let Some(pattern) = config.deny.iter().find(|pattern| pattern.covers(name)) {
        return Err(NotExposed::Denied(pattern.to_string()));
    }
    // A goal that arrives twice is executed twice.
    let action = if thing == Thing::Topic { action_of_topic(name, kind) } else { None };
    let is_exposed = |action: &TopicName| {
        let is_denied = config.deny.iter().any(|pattern| pattern.covers(action));
        !is_denied && config.rule_options(Thing::Call(What::Action), action).is_some()
    };
    if let Some(action) = action.filter(is_exposed) {
        return Err(NotExposed::OfAction(action));
    }
    let why_not = if is_hidden(thing, name) { NotExposed::Hidden } else { NotExposed::NoPattern };
    let rule_options = config.rule_options(thing, name).ok_or(why_not(thing))?;
    if !config.types.is_empty() && !kind.is_some_and(|kind| config.types.contains(kind)) {
        return Err(NotExposed::OtherType);
    }
    let name = remapped(name, &config.remap).ok_or(NotExposed::NoName)?;
    Ok(Exposed { name, rule_options })
}

/// Returns the first of the offered types that the configuration exposes, and how.
pub fn choose(
    config: &ExposeConfig,
    thing: Thing,
    name: &TopicName,
    offered: &[Offered],
) -> Option<(Option<TypeName>, Exposed)> {
    offered.iter().find_map(|it| Some((it.kind.clone(), check_exposed(config, thing, name, it.kind.as_ref()).ok()?)))
}

/// The entities that are exposed at present.
#[derive(Default)]
pub struct Choice {
    chosen: BTreeMap<(Thing, TopicName), Chosen>,
}

struct Chosen {
    kind: Option<TypeName>,
    exposed: Exposed,
    /// The time since which it has had no publisher or server.
    absent_since: Option<Instant>,
}

impl Choice {
    /// Updates the exposed entities. `found` is what the graph has now.
    pub fn update(&mut self, config: &ExposeConfig, found: &Found, now: Instant) {
        self.chosen.retain(|(thing, name), chosen| {
            // Another type makes another name, without the grace period.
            let there = found.get(&(*thing, name.clone()));
            let there = there.map(|offered| offered.iter().any(|it| it.kind == chosen.kind));
            chosen.absent_since = if there == Some(true) { None } else { chosen.absent_since.or(Some(now)) };
            let in_time = chosen.absent_since.is_none_or(|absent_since| now < absent_since + GRACE);
            let checked = || check_exposed(config, *thing, name, chosen.kind.as_ref());
            there != Some(false) && in_time && checked() == Ok(chosen.exposed.clone())
        });
        for (key @ (thing, name), offered) in found {
            if !self.chosen.contains_key(key)
                && let Some((kind, exposed)) = choose(config, *thing, name, offered)
            {
                self.chosen.insert(key.clone(), Chosen { kind, exposed, absent_since: None });
            }
        }
    }

    /// Returns the time at which [`Self::update`] changes the entities without a change of the
    /// graph.
    pub fn due(&self) -> Option<Instant> {
        self.chosen.values().filter_map(|chosen| chosen.absent_since).min().map(|absent_since| absent_since + GRACE)
    }

    pub fn iter(&self) -> impl Iterator<Item = (Thing, &TopicName, Option<&TypeName>, &Exposed)> {
        self.chosen.iter().map(|((thing, name), it)| (*thing, name, it.kind.as_ref(), &it.exposed))
    }
}

#[cfg(test)]
#[path = "../../tests/unit/automatic/choice.rs"]
mod tests;
