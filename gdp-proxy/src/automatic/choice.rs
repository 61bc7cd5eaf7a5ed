//! Which topics of a graph are exposed, and for how long: as the configuration says, while somebody publishes them and a little longer.

use std::collections::BTreeMap;
use std::fmt;
use std::time::{Duration, Instant};

use crate::config::{ExposeConfig, Manner, is_hidden, remapped};
use crate::graph::{Published, Topics};
use crate::ros2::{TopicName, TypeName};

/// For how long a topic without publishers stays: a node that is started anew is back by then.
pub const GRACE: Duration = Duration::from_secs(5);

/// How a topic is exposed.
#[derive(Clone, Debug, PartialEq)]
pub struct Exposed {
    /// What it is called elsewhere.
    pub name: TopicName,
    pub manner: Manner,
}

/// Why a topic is not exposed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NotExposed {
    Denied(String),
    Hidden,
    NoPattern,
    OtherType,
    /// Its name elsewhere would be too long.
    NoName,
}

impl fmt::Display for NotExposed {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Denied(pattern) => write!(f, "deny has {pattern}"),
            Self::Hidden => {
                f.write_str("ROS or the proxy has it for itself: only its own name under topics exposes it")
            }
            Self::NoPattern => f.write_str("no pattern under topics matches"),
            Self::OtherType => f.write_str("its type is not one of types"),
            Self::NoName => f.write_str("its name after remap would be no name of a topic"),
        }
    }
}

/// What the configuration says of a topic of this type.
pub fn judge(config: &ExposeConfig, topic: &TopicName, kind: &TypeName) -> Result<Exposed, NotExposed> {
    if let Some(pattern) = config.deny.iter().find(|pattern| pattern.covers(topic)) {
        return Err(NotExposed::Denied(pattern.to_string()));
    }
    let rule = config.topics.iter().find(|rule| rule.topic.matches(topic));
    let rule = rule.ok_or(if is_hidden(topic) { NotExposed::Hidden } else { NotExposed::NoPattern })?;
    if !config.types.is_empty() && !config.types.contains(kind) {
        return Err(NotExposed::OtherType);
    }
    let name = remapped(topic, &config.remap).ok_or(NotExposed::NoName)?;
    Ok(Exposed { name, manner: rule.manner.or(&config.defaults) })
}

/// Of what a topic is published as, the first that the configuration exposes, and how.
pub fn choose(config: &ExposeConfig, topic: &TopicName, published: &[Published]) -> Option<(TypeName, Exposed)> {
    published.iter().find_map(|it| Some((it.kind.clone(), judge(config, topic, &it.kind).ok()?)))
}

/// The topics that are exposed at a time.
#[derive(Default)]
pub struct Choice {
    chosen: BTreeMap<TopicName, Chosen>,
}

struct Chosen {
    kind: TypeName,
    exposed: Exposed,
    /// When its last publisher had gone.
    gone: Option<Instant>,
}

impl Choice {
    /// `topics` is what the graph has now.
    pub fn update(&mut self, config: &ExposeConfig, topics: &Topics, now: Instant) {
        self.chosen.retain(|topic, chosen| {
            // Publishers of another type make another name, at once.
            let there = topics.get(topic).map(|published| published.iter().any(|it| it.kind == chosen.kind));
            chosen.gone = if there == Some(true) { None } else { chosen.gone.or(Some(now)) };
            let in_time = chosen.gone.is_none_or(|gone| now < gone + GRACE);
            there != Some(false) && in_time && judge(config, topic, &chosen.kind) == Ok(chosen.exposed.clone())
        });
        for (topic, published) in
            topics.iter().filter(|(topic, _)| !self.chosen.contains_key(*topic)).collect::<Vec<_>>()
        {
            if let Some((kind, exposed)) = choose(config, topic, published) {
                self.chosen.insert(topic.clone(), Chosen { kind, exposed, gone: None });
            }
        }
    }

    /// When [`Self::update`] does something though the graph is the same.
    pub fn due(&self) -> Option<Instant> {
        self.chosen.values().filter_map(|chosen| chosen.gone).min().map(|gone| gone + GRACE)
    }

    pub fn iter(&self) -> impl Iterator<Item = (&TopicName, &TypeName, &Exposed)> {
        self.chosen.iter().map(|(topic, Chosen { kind, exposed, .. })| (topic, kind, exposed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deny_wins_and_nothing_is_exposed_that_is_not_named() {
        let config = config(
            "topics: [/camera/**, /odom, /rosout], deny: [/camera/raw, /**/secret/**, /parameter*], types: [a/msg/B]",
        );
        let judge =
            |topic: &str, kind: &str| judge(&config, &name(topic), &TypeName::parse(kind).unwrap()).map(|it| it.name);
        assert_eq!(judge("/camera/left", "a/msg/B"), Ok(name("/camera/left")));
        assert_eq!(judge("/camera/raw", "a/msg/B"), Err(NotExposed::Denied("/camera/raw".into())));
        assert_eq!(judge("/camera/secret/x", "a/msg/B"), Err(NotExposed::Denied("/**/secret/**".into())));
        assert_eq!(judge("/cmd_vel", "a/msg/B"), Err(NotExposed::NoPattern));
        assert_eq!(judge("/camera/_hidden", "a/msg/B"), Err(NotExposed::Hidden));
        assert_eq!(judge("/rosout", "a/msg/B"), Ok(name("/rosout")));
        assert_eq!(judge("/odom", "a/msg/C"), Err(NotExposed::OtherType));
    }

    #[test]
    fn the_first_pattern_says_how() {
        let config =
            config("topics: [{topic: /a, max_hz: 1}, /**], remap: [{from: /a, to: /r1/a}], defaults: {priority: 7}");
        let exposed = judge(&config, &name("/a"), &kind()).unwrap();
        assert_eq!((exposed.name, exposed.manner.max_hz.unwrap().get()), (name("/r1/a"), 1));
        assert_eq!(judge(&config, &name("/b"), &kind()).unwrap().manner.priority.unwrap().get(), 7);
    }

    #[test]
    fn a_topic_stays_a_little_longer_than_its_publishers() {
        let (config, start) = (config("topics: [/**]"), Instant::now());
        let mut choice = Choice::default();
        let names = |choice: &Choice| choice.iter().map(|(topic, ..)| topic.to_string()).collect::<Vec<_>>().join(" ");
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
            let published = |kind: &&str| Published { kind: TypeName::parse(kind).unwrap(), qos: None };
            Topics::from([(name("/a"), kinds.iter().map(published).collect())])
        };
        let kind = |choice: &Choice| choice.iter().next().map(|(_, kind, _)| kind.to_string());
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

    fn topics(names: &[&str]) -> Topics {
        names.iter().map(|topic| (name(topic), vec![Published { kind: kind(), qos: None }])).collect()
    }

    fn name(text: &str) -> TopicName {
        TopicName::parse(text).unwrap()
    }

    fn kind() -> TypeName {
        TypeName::parse("std_msgs/msg/String").unwrap()
    }
}
