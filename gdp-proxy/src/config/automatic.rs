//! The sections `expose` and `import`: patterns of local topics, services and actions, and patterns
//! of those that remote catalogs list.

use std::collections::BTreeMap;
use std::fmt;
use std::num::NonZeroU32;
use std::path::PathBuf;

use gdp_core::cert::Grantee;
use gdp_ros::catalog::MAX_GRANTS;
use gdp_ros::services::IDEMPOTENT;
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::de::value::MapAccessDeserializer;
use serde::de::{self, MapAccess, Visitor};
use serde::{Deserialize, Deserializer};

use super::calls::check_copies;
use super::shared::{SharedImport, SharedTopics};
use super::topics::Priority;
use super::{Compression, Conversion, Direction, FramePrefix, Graphs, Pattern, Thing, TopicConfig, What, schema};
use crate::ros2::{Qos, TopicName, TypeName};

/// The local topics, services and actions that the proxy exposes while a node publishes or serves
/// them. The proxy makes their names with the owner's key and lists them in a catalog.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ExposeConfig {
    /// Name of the graph, if there are several.
    #[serde(default)]
    pub graph: Option<String>,
    /// The private key of the owner of these names (`gdp-ctl key generate FILE --kind owner`). The
    /// owner should have no other names.
    pub owner: PathBuf,
    /// The name card of the catalog, a name of the same owner (`gdp-ctl name create --kind
    /// catalog`).
    pub catalog: PathBuf,
    /// Patterns of the exposed topics, each alone or with options.
    #[serde(default)]
    #[schemars(schema_with = "schema::rules")]
    pub topics: Vec<Rule>,
    /// Patterns of the exposed services.
    #[serde(default)]
    pub services: Vec<Pattern>,
    /// Patterns of the exposed services that several servers may execute for one call. Their name
    /// cards state it, so that clients may `replicate` their calls.
    #[serde(default)]
    pub idempotent: Vec<Pattern>,
    /// Patterns of the exposed actions. The topics of such an action in ROS 1 are not exposed.
    #[serde(default)]
    pub actions: Vec<Pattern>,
    /// If not empty: only entities of these types are exposed, as ROS 2 writes them. ROS 1 does not
    /// announce the types of services.
    #[serde(default)]
    pub types: Vec<TypeName>,
    /// Patterns of topics, services and actions that are never exposed, whatever else matches.
    #[serde(default)]
    pub deny: Vec<Pattern>,
    /// Entities and roles in domains that may read everything exposed.
    #[serde(default)]
    #[schemars(schema_with = "schema::readers")]
    pub readers: Vec<ReaderConfig>,
    /// Domains besides the proxy's own in which the names may be announced.
    #[serde(default)]
    #[schemars(with = "Vec<String>")]
    pub scope: Vec<Name>,
    /// Names of the entities outside of this graph.
    #[serde(default)]
    pub remap: Vec<Remap>,
    /// Default options of the exposed topics. Only `meta` also applies to services and actions.
    #[serde(default)]
    pub defaults: RuleOptions,
    /// What the domain's directory adds.
    #[serde(skip)]
    pub shared: SharedTopics,
}

/// The remote topics, services and actions that the proxy imports while a catalog lists them.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ImportConfig {
    /// Name of the graph, if there are several.
    #[serde(default)]
    pub graph: Option<String>,
    /// The name card of the catalog.
    pub catalog: PathBuf,
    /// The owner's grant to read the catalog (`gdp-ctl grant add --read`).
    pub grant: PathBuf,
    /// Patterns of the imported topics, with their names in the catalog.
    #[serde(default)]
    pub topics: Vec<Pattern>,
    /// Patterns of the imported services, with their names in the catalog.
    #[serde(default)]
    pub services: Vec<Pattern>,
    /// Patterns of the imported actions, with their names in the catalog.
    #[serde(default)]
    pub actions: Vec<Pattern>,
    /// Patterns of topics, services and actions that are never imported, whatever else matches.
    #[serde(default)]
    pub deny: Vec<Pattern>,
    /// Names of the entities in this graph.
    #[serde(default)]
    pub remap: Vec<Remap>,
    /// A namespace that is put in front of all names, after `remap`.
    #[serde(default)]
    pub prefix: Option<TopicName>,
    /// Patterns of imported topics, with their names in the catalog, that get no `prefix` and merge
    /// with other imports of the same name, such as `/tf`.
    #[serde(default)]
    pub merge: Vec<Pattern>,
    /// Prefix of the frame names in all topics; see `topics`.
    #[serde(default)]
    pub frame_prefix: Option<FramePrefix>,
    /// QoS in this graph. If absent: the QoS that each publisher offers.
    #[serde(default)]
    pub qos: Option<Qos>,
    /// Receives each topic over two links at once.
    #[serde(default)]
    pub duplicate: bool,
    /// The number of servers, the nearest ones, to which each call of an idempotent service goes at
    /// once. The first answer counts. Calls of other services go to one server.
    #[serde(default)]
    #[schemars(range(min = 2, max = 8))]
    pub replicate: Option<u8>,
    /// What the directory of the domain states about this import.
    #[serde(skip)]
    pub shared: Option<SharedImport>,
}

/// A pattern of topics with their options.
#[derive(Clone, Debug, PartialEq)]
pub struct Rule {
    pub topic: Pattern,
    pub rule_options: RuleOptions,
}

/// Options of topics. The defaults are those of `topics`.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RuleOptions {
    /// QoS of the topic. If absent: the QoS that each publisher offers.
    pub qos: Option<Qos>,
    pub encoding: Option<Conversion>,
    pub compression: Option<Compression>,
    pub frame_prefix: Option<FramePrefix>,
    /// Maximum rate of each publisher in messages per second; see `topics`.
    pub max_hz: Option<NonZeroU32>,
    pub priority: Option<Priority>,
    /// Sends each frame over two links at once.
    pub duplicate: Option<bool>,
    /// Further metadata of the name cards. Another value makes another name.
    pub meta: BTreeMap<String, String>,
    /// Of idempotent services that are imported: see `import`.
    #[serde(skip)]
    pub replicate: Option<u8>,
}

/// A pattern of topics with their options, as written in the file.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct RuleSaid {
    /// The pattern, such as `/camera/**`.
    topic: Pattern,
    /// QoS of the topics. If absent: the QoS that each publisher offers.
    #[serde(default)]
    qos: Option<Qos>,
    #[serde(default)]
    encoding: Option<Conversion>,
    #[serde(default)]
    compression: Option<Compression>,
    #[serde(default)]
    frame_prefix: Option<FramePrefix>,
    /// Maximum rate of each publisher in messages per second.
    #[serde(default)]
    max_hz: Option<NonZeroU32>,
    #[serde(default)]
    priority: Option<Priority>,
    /// Sends each frame over two links at once.
    #[serde(default)]
    duplicate: Option<bool>,
    /// Further metadata of the name cards. Another value makes another name.
    #[serde(default)]
    meta: BTreeMap<String, String>,
}

/// A reader of exposed names: an entity, or a role in a domain.
#[derive(Clone, Debug, PartialEq)]
pub struct ReaderConfig(pub Grantee);

#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Role {
    /// The domain's name, 64 hex digits.
    #[schemars(with = "String")]
    domain: Name,
    /// The role of its members.
    role: String,
}

/// Another name for a topic, service or action, or for a namespace with everything in it.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Remap {
    pub from: TopicName,
    pub to: TopicName,
}

impl RuleOptions {
    /// Returns these options, with absent ones taken from `defaults`.
    pub fn or(&self, defaults: &Self) -> Self {
        let mut meta = defaults.meta.clone();
        meta.extend(self.meta.clone());
        Self {
            qos: self.qos.or(defaults.qos),
            encoding: self.encoding.or(defaults.encoding),
            compression: self.compression.or(defaults.compression),
            frame_prefix: self.frame_prefix.as_ref().or(defaults.frame_prefix.as_ref()).cloned(),
            max_hz: self.max_hz.or(defaults.max_hz),
            priority: self.priority.or(defaults.priority),
            duplicate: self.duplicate.or(defaults.duplicate),
            replicate: self.replicate.or(defaults.replicate),
            meta,
        }
    }

    /// Returns the configuration of a topic of `graph` with these options.
    pub fn topic(&self, topic: &TopicName, graph: &str, kind: Option<TypeName>, direction: Direction) -> TopicConfig {
        let Self { qos, encoding, compression, frame_prefix, max_hz, priority, duplicate, .. } = self;
        TopicConfig {
            graph: Some(graph.into()),
            kind,
            qos: *qos,
            encoding: encoding.unwrap_or_default(),
            compression: compression.unwrap_or_default(),
            frame_prefix: frame_prefix.clone(),
            max_hz: *max_hz,
            priority: priority.unwrap_or_default(),
            duplicate: duplicate.unwrap_or_default(),
            ..TopicConfig::without_files(topic.clone(), direction)
        }
    }
}

/// Returns the name after the first matching remapping. `None` if the new name is invalid, for
/// example too long.
pub fn remapped(topic: &TopicName, remap: &[Remap]) -> Option<TopicName> {
    let rest = |from: &TopicName| {
        let rest = topic.as_str().strip_prefix(from.as_str())?;
        (rest.is_empty() || rest.starts_with('/')).then_some(rest)
    };
    match remap.iter().find_map(|remap| Some((&remap.to, rest(&remap.from)?))) {
        Some((to, rest)) => TopicName::parse(&format!("{to}{rest}")).ok(),
        None => Some(topic.clone()),
    }
}

impl ExposeConfig {
    /// Returns the options of an entity, or `None` if no pattern matches it.
    pub fn rule_options(&self, thing: Thing, name: &TopicName) -> Option<RuleOptions> {
        let exports = self.shared.exports.of_kind(thing);
        let called = |patterns: &[Pattern]| {
            let is_meant = patterns.iter().chain(exports).any(|pattern| pattern.matches(thing, name));
            is_meant.then(|| RuleOptions { meta: self.defaults.meta.clone(), ..RuleOptions::default() })
        };
        match thing {
            Thing::Topic => {
                let rule = self.topics.iter().find(|rule| rule.topic.matches(thing, name));
                let is_export = || exports.iter().any(|pattern| pattern.matches(thing, name));
                match rule {
                    Some(rule) => Some(rule.rule_options.or(&self.defaults)),
                    None => is_export().then(|| self.defaults.clone()),
                }
            }
            Thing::Call(What::Service) => {
                let mut rule_options = called(&self.services)?;
                if self.idempotent.iter().any(|pattern| pattern.matches(thing, name)) {
                    rule_options.meta.insert(IDEMPOTENT.into(), "true".into());
                }
                Some(rule_options)
            }
            Thing::Call(What::Action) => called(&self.actions),
        }
    }

    fn manners(&self) -> impl Iterator<Item = &RuleOptions> {
        self.topics.iter().map(|rule| &rule.rule_options).chain([&self.defaults])
    }

    /// Whether any topic is sent over two links.
    pub(super) fn duplicates(&self) -> bool {
        self.manners().any(|rule_options| rule_options.duplicate == Some(true))
    }

    /// Checks the section. Errors come with the key inside `expose`. With a directory, it may name
    /// nothing, because the members import by the directory.
    pub(super) fn check(&self, graphs: &Graphs, has_directory: bool) -> Result<(), (&'static str, String)> {
        check_patterns(
            has_directory || !self.topics.is_empty(),
            &self.services,
            &self.actions,
            self.graph.as_deref(),
            graphs,
        )?;
        if self.readers.len() > MAX_GRANTS {
            return Err(("readers", format!("more than {MAX_GRANTS}; give them a role in a domain")));
        }
        if self.services.is_empty() && !self.idempotent.is_empty() {
            return Err(("idempotent", "is for services, and services has no pattern; add one, or remove it".into()));
        }
        let manners = self.manners();
        for key in manners.flat_map(|rule_options| rule_options.meta.keys()) {
            if matches!(key.as_str(), "kind" | "topic" | "type" | "nonce") {
                return Err(("meta", format!("{key} is said by the proxy itself; remove it")));
            }
            if key == IDEMPOTENT {
                return Err(("meta", format!("{key} is for single services; list their patterns under {key}")));
            }
        }
        Ok(())
    }
}

impl ImportConfig {
    /// Checks the section. Errors come with the key inside the import.
    pub(super) fn check(&self, graphs: &Graphs) -> Result<(), (&'static str, String)> {
        check_patterns(!self.topics.is_empty(), &self.services, &self.actions, self.graph.as_deref(), graphs)?;
        match self.replicate {
            None => Ok(()),
            Some(_) if self.services.is_empty() => {
                Err(("replicate", "is for services, and services has no pattern; add one, or remove it".into()))
            }
            Some(copies) => check_copies(copies).map_err(|reason| ("replicate", reason)),
        }
    }

    /// Whether the import selects the entity.
    pub fn wants(&self, thing: Thing, name: &TopicName) -> bool {
        let patterns = match thing {
            Thing::Topic => &self.topics,
            Thing::Call(What::Service) => &self.services,
            Thing::Call(What::Action) => &self.actions,
        };
        let any = |patterns: &[Pattern]| patterns.iter().any(|pattern| pattern.covers(name));
        let is_within = |shared: &SharedImport| shared.within.covers(thing, name) || self.keeps_name(thing, name);
        let is_within = self.shared.as_ref().is_none_or(is_within);
        is_within && !any(&self.deny) && patterns.iter().any(|pattern| pattern.matches(thing, name))
    }

    /// Whether any services or actions may be imported.
    pub fn wants_calls(&self) -> bool {
        !self.services.is_empty() || !self.actions.is_empty()
    }

    /// Whether an imported entity has no prefix.
    fn keeps_name(&self, thing: Thing, name: &TopicName) -> bool {
        let is_shared = |shared: &SharedImport| shared.under_own_names.covers(thing, name);
        self.merges(thing, name) || self.shared.as_ref().is_some_and(is_shared)
    }

    /// Whether an imported entity merges with others of the same name.
    pub fn merges(&self, thing: Thing, name: &TopicName) -> bool {
        let shared = self.shared.iter().flat_map(|shared| &shared.under_own_names.topics);
        thing == Thing::Topic && self.merge.iter().chain(shared).any(|pattern| pattern.covers(name))
    }

    /// Returns the name of an imported entity in this graph. `None` if the name is invalid, for
    /// example too long.
    pub fn local_name(&self, thing: Thing, name: &TopicName) -> Option<TopicName> {
        let topic = remapped(name, &self.remap)?;
        match &self.prefix {
            Some(prefix) if !self.keeps_name(thing, name) => TopicName::parse(&format!("{prefix}{topic}")).ok(),
            _ => Some(topic),
        }
    }

    pub fn rule_options(&self) -> RuleOptions {
        let frame_prefix = self.frame_prefix.clone();
        let (qos, duplicate, replicate) = (self.qos, Some(self.duplicate), self.replicate);
        RuleOptions { qos, duplicate, frame_prefix, replicate, ..RuleOptions::default() }
    }
}

fn check_patterns(
    has_topics: bool,
    services: &[Pattern],
    actions: &[Pattern],
    graph: Option<&str>,
    graphs: &Graphs,
) -> Result<(), (&'static str, String)> {
    graphs.get(graph).map_err(|reason| ("graph", reason))?;
    if has_topics || !services.is_empty() || !actions.is_empty() {
        return Ok(());
    }
    Err(("topics", "no pattern here, in services or in actions, so nothing would cross".into()))
}

impl From<RuleSaid> for Rule {
    fn from(said: RuleSaid) -> Self {
        let RuleSaid { topic, qos, encoding, compression, frame_prefix, max_hz, priority, duplicate, meta } = said;
        Self {
            topic,
            rule_options: RuleOptions {
                qos,
                encoding,
                compression,
                frame_prefix,
                max_hz,
                priority,
                duplicate,
                meta,
                replicate: None,
            },
        }
    }
}

impl<'de> Deserialize<'de> for Rule {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = |text: &str| Ok(Self { topic: Pattern::parse(text)?, rule_options: RuleOptions::default() });
        let expecting = "a pattern such as /camera/**, or a mapping such as {topic: /camera/**, max_hz: 5}";
        deserializer.deserialize_any(TextOrMap { expecting, text, map: |said: RuleSaid| Ok(said.into()) })
    }
}

impl<'de> Deserialize<'de> for ReaderConfig {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text =
            |text: &str| text.parse().map(|name| Self(Grantee::Entity(name))).map_err(|error| format!("{error}"));
        let map = |Role { domain, role }| Ok(Self(Grantee::Role { domain, role }));
        let expecting = "the name of an entity, or a mapping {domain: NAME, role: ROLE}";
        deserializer.deserialize_any(TextOrMap { expecting, text, map })
    }
}

/// Accepts a text or a mapping. An untagged enum would not name a misspelt key.
struct TextOrMap<T, M> {
    expecting: &'static str,
    text: fn(&str) -> Result<T, String>,
    map: fn(M) -> Result<T, String>,
}

impl<'de, T, M: Deserialize<'de>> Visitor<'de> for TextOrMap<T, M> {
    type Value = T;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(self.expecting)
    }

    fn visit_str<E: de::Error>(self, text: &str) -> Result<T, E> {
        (self.text)(text).map_err(E::custom)
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<T, A::Error> {
        (self.map)(M::deserialize(MapAccessDeserializer::new(map))?).map_err(de::Error::custom)
    }
}

#[cfg(test)]
#[path = "../../tests/unit/config/automatic.rs"]
mod tests;
