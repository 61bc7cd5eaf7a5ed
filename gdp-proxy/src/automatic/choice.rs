//! What of a graph is exposed, and for how long: as the configuration says, while somebody publishes or serves it and a little longer.

use std::collections::BTreeMap;
use std::fmt;
use std::time::{Duration, Instant};

use crate::config::{ExposeConfig, Manner, Thing, is_hidden, remapped};
use crate::graph::{Found, Offered};
use crate::ros2::{TopicName, TypeName};

/// For how long what nobody publishes or serves any more stays: a node that is started anew is back by then.
pub const GRACE: Duration = Duration::from_secs(5);

/// How something is exposed.
#[derive(Clone, Debug, PartialEq)]
pub struct Exposed {
    /// What it is called elsewhere.
    pub name: TopicName,
    pub manner: Manner,
}

/// Why something is not exposed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NotExposed {
    Denied(String),
    Hidden(Thing),
    NoPattern(Thing),
    OtherType,
    /// Its name elsewhere would be too long.
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
            Self::NoName => f.write_str("its name after remap would be too long"),
        }
    }
}

/// What the configuration says of something of this type.
pub fn judge(
    config: &ExposeConfig,
    thing: Thing,
    name: &TopicName,
    kind: Option<&TypeName>,
) -> Result<Exposed, NotExposed> {
    if let Some(pattern) = config.deny.iter().find(|pattern| pattern.covers(name)) {
        return Err(NotExposed::Denied(pattern.to_string()));
    }
    let why_not = if is_hidden(thing, name) { NotExposed::Hidden } else { NotExposed::NoPattern };
    let manner = config.manner(thing, name).ok_or(why_not(thing))?;
    if !config.types.is_empty() && !kind.is_some_and(|kind| config.types.contains(kind)) {
        return Err(NotExposed::OtherType);
    }
    let name = remapped(name, &config.remap).ok_or(NotExposed::NoName)?;
    Ok(Exposed { name, manner })
}

/// Of what something is offered as, the first that the configuration exposes, and how.
pub fn choose(
    config: &ExposeConfig,
    thing: Thing,
    name: &TopicName,
    offered: &[Offered],
) -> Option<(Option<TypeName>, Exposed)> {
    offered.iter().find_map(|it| Some((it.kind.clone(), judge(config, thing, name, it.kind.as_ref()).ok()?)))
}

/// What is exposed at a time.
#[derive(Default)]
pub struct Choice {
    chosen: BTreeMap<(Thing, TopicName), Chosen>,
}

struct Chosen {
    kind: Option<TypeName>,
    exposed: Exposed,
    /// When its last publisher or server had gone.
    gone: Option<Instant>,
}

impl Choice {
    /// `found` is what the graph has now.
    pub fn update(&mut self, config: &ExposeConfig, found: &Found, now: Instant) {
        self.chosen.retain(|(thing, name), chosen| {
            // Another type makes another name, at once.
            let there = found.get(&(*thing, name.clone()));
            let there = there.map(|offered| offered.iter().any(|it| it.kind == chosen.kind));
            chosen.gone = if there == Some(true) { None } else { chosen.gone.or(Some(now)) };
            let in_time = chosen.gone.is_none_or(|gone| now < gone + GRACE);
            let judged = || judge(config, *thing, name, chosen.kind.as_ref());
            there != Some(false) && in_time && judged() == Ok(chosen.exposed.clone())
        });
        for (key @ (thing, name), offered) in found {
            if !self.chosen.contains_key(key)
                && let Some((kind, exposed)) = choose(config, *thing, name, offered)
            {
                self.chosen.insert(key.clone(), Chosen { kind, exposed, gone: None });
            }
        }
    }

    /// When [`Self::update`] does something though the graph is the same.
    pub fn due(&self) -> Option<Instant> {
        self.chosen.values().filter_map(|chosen| chosen.gone).min().map(|gone| gone + GRACE)
    }

    pub fn iter(&self) -> impl Iterator<Item = (Thing, &TopicName, Option<&TypeName>, &Exposed)> {
        self.chosen.iter().map(|((thing, name), it)| (*thing, name, it.kind.as_ref(), &it.exposed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::What;

    #[test]
    fn deny_wins_and_nothing_is_exposed_that_is_not_named() {
        let config = config(
            "topics: [/camera/**, /odom, /rosout], deny: [/camera/raw, /**/secret/**, /parameter*], types: [a/msg/B]",
        );
        let judge = |topic: &str, kind: &str| {
            judge(&config, Thing::Topic, &name(topic), TypeName::parse(kind).ok().as_ref()).map(|it| it.name)
        };
        assert_eq!(judge("/camera/left", "a/msg/B"), Ok(name("/camera/left")));
        assert_eq!(judge("/camera/raw", "a/msg/B"), Err(NotExposed::Denied("/camera/raw".into())));
        assert_eq!(judge("/camera/secret/x", "a/msg/B"), Err(NotExposed::Denied("/**/secret/**".into())));
        assert_eq!(judge("/cmd_vel", "a/msg/B"), Err(NotExposed::NoPattern(Thing::Topic)));
        assert_eq!(judge("/camera/_hidden", "a/msg/B"), Err(NotExposed::Hidden(Thing::Topic)));
        assert_eq!(judge("/rosout", "a/msg/B"), Ok(name("/rosout")));
        assert_eq!(judge("/odom", "a/msg/C"), Err(NotExposed::OtherType));
    }

    #[test]
    fn the_first_pattern_says_how() {
        let config =
            config("topics: [{topic: /a, max_hz: 1}, /**], remap: [{from: /a, to: /r1/a}], defaults: {priority: 7}");
        let exposed = judge(&config, Thing::Topic, &name("/a"), Some(&kind())).unwrap();
        assert_eq!((exposed.name, exposed.manner.max_hz.unwrap().get()), (name("/r1/a"), 1));
        assert_eq!(judge(&config, Thing::Topic, &name("/b"), Some(&kind())).unwrap().manner.priority.unwrap().get(), 7);
    }

    #[test]
    fn what_is_called_is_exposed_by_its_own_patterns_and_none_that_nodes_have_for_themselves() {
        let config = config(
            "topics: [/a/topic], services: [/a/**, /b/get_parameters], actions: [/arm/*], deny: [/a/stop], \
             remap: [{from: /a, to: /r1/a}], defaults: {max_hz: 5, meta: {site: x}}",
        );
        let (service, action) = (Thing::Call(What::Service), Thing::Call(What::Action));
        let judge = |thing, text: &str| judge(&config, thing, &name(text), None).map(|it| it.name.to_string());
        assert_eq!(judge(service, "/a/light"), Ok("/r1/a/light".into()));
        assert_eq!(judge(service, "/a/stop"), Err(NotExposed::Denied("/a/stop".into())));
        assert_eq!(judge(service, "/a/set_parameters"), Err(NotExposed::Hidden(service)));
        assert_eq!(judge(service, "/b/get_parameters"), Ok("/b/get_parameters".into()));
        assert_eq!(judge(service, "/arm/dock"), Err(NotExposed::NoPattern(service)));
        assert_eq!(judge(action, "/arm/dock"), Ok("/arm/dock".into()));
        assert_eq!(judge(Thing::Topic, "/a/light"), Err(NotExposed::NoPattern(Thing::Topic)));
        let manner = config.manner(service, &name("/a/light")).unwrap();
        assert_eq!((manner.max_hz, manner.meta["site"].as_str()), (None, "x"));
    }

    #[test]
    fn where_types_are_named_what_has_none_is_not_exposed() {
        let config = config("services: [/**], types: [a/srv/B]");
        let judge = |kind: Option<&str>| {
            let kind = kind.map(|kind| TypeName::parse(kind).unwrap());
            judge(&config, Thing::Call(What::Service), &name("/a"), kind.as_ref()).map(|_| ())
        };
        assert_eq!(judge(Some("a/srv/B")), Ok(()));
        assert_eq!([None, Some("a/srv/C")].map(judge), [Err(NotExposed::OtherType), Err(NotExposed::OtherType)]);
    }

    #[test]
    fn a_topic_stays_a_little_longer_than_its_publishers() {
        let (config, start) = (config("topics: [/**]"), Instant::now());
        let mut choice = Choice::default();
        let names = |choice: &Choice| choice.iter().map(|(_, name, ..)| name.to_string()).collect::<Vec<_>>().join(" ");
        choice.update(&config, &topics(&["/a", "/b", "/_c"]), start);
        assert_eq!((names(&choice), choice.due()), ("/a /b".into(), None));
        choice.update(&config, &topics(&["/b"]), start);
        assert_eq!((names(&choice), choice.due()), ("/a /b".into(), Some(start + GRACE)));
        // Back in time, and gone again.
        choice.update(&config, &topics(&["/a", "/b"]), start + GRACE / 2);
        assert_eq!(choice.due(), None);
        choice.update(&config, &topics(&["/b"]), start + GRACE);
        assert_eq!(names(&choice), "/a /b");
        choice.update(&config, &topics(&["/b"]), start + 2 * GRACE);
        assert_eq!((names(&choice), choice.due()), ("/b".into(), None));
    }

    #[test]
    fn another_type_is_another_name_once_nobody_has_the_first() {
        let (config, now) = (config("topics: [/**]"), Instant::now());
        let mut choice = Choice::default();
        let of = |kinds: &[&str]| {
            let offered = |kind: &&str| Offered { kind: TypeName::parse(kind).ok(), qos: None };
            Found::from([((Thing::Topic, name("/a")), kinds.iter().map(offered).collect())])
        };
        let kind = |choice: &Choice| choice.iter().next().and_then(|(_, _, kind, _)| Some(kind?.to_string()));
        choice.update(&config, &of(&["x/msg/A"]), now);
        choice.update(&config, &of(&["x/msg/B", "x/msg/A"]), now);
        assert_eq!(kind(&choice).unwrap(), "x/msg/A");
        choice.update(&config, &of(&["x/msg/B"]), now);
        assert_eq!(kind(&choice).unwrap(), "x/msg/B");
    }

    #[test]
    fn what_the_configuration_says_otherwise_counts_at_once() {
        let now = Instant::now();
        let mut choice = Choice::default();
        choice.update(&config("topics: [/**]"), &topics(&["/a", "/b"]), now);
        choice.update(&config("topics: [/**], deny: [/a]"), &topics(&["/a", "/b"]), now);
        assert_eq!(choice.iter().count(), 1);
    }

    fn config(says: &str) -> ExposeConfig {
        serde_saphyr::from_str(&format!("{{owner: o, catalog: c, {says}}}")).unwrap()
    }

    fn topics(names: &[&str]) -> Found {
        let offered = || vec![Offered { kind: Some(kind()), qos: None }];
        names.iter().map(|topic| ((Thing::Topic, name(topic)), offered())).collect()
    }

    fn name(text: &str) -> TopicName {
        TopicName::parse(text).unwrap()
    }

    fn kind() -> TypeName {
        TypeName::parse("std_msgs/msg/String").unwrap()
    }
}
