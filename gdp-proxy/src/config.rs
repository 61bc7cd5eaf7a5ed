//! The configuration file: which topics cross, in which direction, under whose keys. Strict, because a misspelt key in a
//! file about permissions must not pass for a default. The default exposes nothing.
//!
//! This is the file alone; [`crate::material`] reads the files it names.

mod relay;

use std::fs::File;
use std::io::{self, Read};
use std::num::NonZeroU64;
use std::path::{Path, PathBuf};

use gdp::Name;
use gdp::domain::PaperFiles;
use gdp::link::MAX_LANES;
use gdp::node::{LinkConfig, LinkTarget};
use serde::{Deserialize, Deserializer, de};

pub use self::relay::RelayConfig;
use crate::ros2::{self, Qos, TopicName, TypeName};

/// A longer file is no configuration.
const MAX_FILE: u64 = 1024 * 1024;

/// Topics of one proxy.
const MAX_TOPICS: usize = 1024;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The proxy's private key (`gdp-ctl key generate FILE --kind proxy`).
    pub identity: PathBuf,
    /// The ways to the fabric, in the order in which they are wanted: everything goes by the first that is up.
    pub links: Vec<LinkPlace>,
    /// A folder for what the proxy must not forget, which is what owners have revoked; made if there is none.
    #[serde(default)]
    pub state: Option<PathBuf>,
    /// The trust domain that the proxy is a member of, if it is of one.
    #[serde(default)]
    pub domain: Option<DomainConfig>,
    /// If it also carries others.
    #[serde(default, deserialize_with = "relay::relay")]
    pub relay: Option<RelayConfig>,
    /// ROS_DOMAIN_ID.
    #[serde(default)]
    pub domain_id: DomainId,
    #[serde(default)]
    pub topics: Vec<TopicConfig>,
}

/// What makes the proxy a member of a trust domain (`gdp-ctl domain`).
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DomainConfig {
    /// The domain's card.
    pub card: PathBuf,
    /// Read again when it changes, as the others.
    pub membership: PathBuf,
    /// What the domain lets other domains do; for those that the robot visits.
    #[serde(default)]
    pub peers: Vec<PathBuf>,
}

impl From<&DomainConfig> for PaperFiles {
    fn from(config: &DomainConfig) -> Self {
        let DomainConfig { card, membership, peers } = config;
        Self { card: card.clone(), membership: membership.clone(), peers: peers.clone() }
    }
}

/// One way to the fabric.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinkPlace {
    /// Where the switch is: `eth://INTERFACE`, `eth://INTERFACE/MAC`, `udp://HOST:PORT` or `udp://HOST:PORT%INTERFACE`.
    #[serde(deserialize_with = "from_text")]
    pub to: LinkTarget,
    /// The switch that must be there, if only one will do.
    #[serde(default)]
    pub switch: Option<Name>,
    /// Bytes a second that topics may send this way.
    #[serde(default)]
    pub budget: Option<NonZeroU64>,
}

impl From<&LinkPlace> for LinkConfig {
    fn from(place: &LinkPlace) -> Self {
        let LinkPlace { to, switch, budget } = place;
        Self { target: to.clone(), switch: *switch, budget: budget.map(NonZeroU64::get) }
    }
}

/// One topic in one direction.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TopicConfig {
    pub topic: TopicName,
    /// If absent: what the name card says; if it says nothing, what the local publishers of an `out` topic use.
    #[serde(default, rename = "type")]
    pub kind: Option<TypeName>,
    pub direction: Direction,
    /// The topic's name card (`gdp-ctl name create`).
    pub card: PathBuf,
    /// The owner's permission for this proxy: to publish (`gdp-ctl grant add --publish`) if `out`, to read
    /// (`gdp-ctl grant add --read`) if `in`; with what it rests on, such as a delegation, after it.
    pub cert: PathBuf,
    #[serde(default)]
    pub qos: Qos,
    /// It crosses by two links at once, so that nothing is missed when one fails: `out`, a copy of each frame goes by the second; `in`,
    /// it comes by each.
    #[serde(default)]
    pub duplicate: bool,
    /// Refused with the remedy: earlier versions shared a secret file here.
    #[serde(default, rename = "key")]
    _key: NoKey,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Deserialize, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    /// From local ROS nodes into the fabric.
    Out,
    /// From the fabric to local ROS nodes.
    In,
}

/// What no file says.
#[derive(Clone, Debug, Default)]
struct NoKey;

impl<'de> Deserialize<'de> for NoKey {
    fn deserialize<D: Deserializer<'de>>(_: D) -> Result<Self, D::Error> {
        Err(de::Error::custom(
            "there is no `key` any more: writers give each reader its keys. Remove it here, and the file on every machine",
        ))
    }
}

/// A DDS domain id that has ports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(try_from = "u64")]
pub struct DomainId(u16);

impl DomainId {
    pub fn get(self) -> u16 {
        self.0
    }
}

impl TryFrom<u64> for DomainId {
    type Error = String;

    fn try_from(id: u64) -> Result<Self, String> {
        match u16::try_from(id) {
            Ok(id @ 0..=ros2::MAX_DOMAIN_ID) => Ok(Self(id)),
            _ => Err(format!("there is no DDS domain {id}: write the ROS_DOMAIN_ID, 0 to {}", ros2::MAX_DOMAIN_ID)),
        }
    }
}

/// Why there is no configuration. Every text begins with the file.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    #[error("{}: cannot be read: {source}", path.display())]
    Io { path: PathBuf, source: io::Error },
    #[error("{}: longer than {MAX_FILE} bytes, so not a proxy configuration", .0.display())]
    TooLong(PathBuf),
    #[error("{}: {message}", path.display())]
    Syntax { path: PathBuf, message: String },
    #[error("{}: {key}: {reason}", path.display())]
    Invalid { path: PathBuf, key: String, reason: String },
}

impl Config {
    /// Reads and checks a file. Relative paths in it are made relative to the folder the file is in.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let io = |source| ConfigError::Io { path: path.into(), source };
        let mut text = String::new();
        let length = File::open(path).map_err(io)?.take(MAX_FILE + 1).read_to_string(&mut text).map_err(io)?;
        if length as u64 > MAX_FILE {
            return Err(ConfigError::TooLong(path.into()));
        }
        Self::parse(&text, path)
    }

    /// The same for a text; `path` is the file it would be in.
    pub fn parse(text: &str, path: &Path) -> Result<Self, ConfigError> {
        // Errors quote no lines: the file given by mistake may be a private key.
        let options = serde_saphyr::options! { with_snippet: false };
        let mut config: Self = serde_saphyr::from_str_with_options(text, options)
            .map_err(|error| ConfigError::Syntax { path: path.into(), message: error.to_string() })?;
        config.check().map_err(|(key, reason)| ConfigError::Invalid { path: path.into(), key, reason })?;
        config.resolve(path.parent().unwrap_or(Path::new("")));
        Ok(config)
    }

    fn check(&self) -> Result<(), (String, String)> {
        if self.topics.len() > MAX_TOPICS {
            return Err(("topics".into(), format!("more than {MAX_TOPICS}; run a second proxy")));
        }
        if !(1..=MAX_LANES).contains(&self.links.len()) {
            return Err(("links".into(), format!("{} of them; a proxy has 1 to {MAX_LANES}", self.links.len())));
        }
        for (i, link) in self.links.iter().enumerate() {
            if let Some(first) = self.links[..i].iter().position(|other| other.to == link.to) {
                return Err((format!("links[{i}].to"), format!("{} is already links[{first}]; remove one", link.to)));
            }
        }
        if self.domain.is_none() && self.relay.as_ref().is_some_and(|relay| relay.membership.is_some()) {
            return Err((
                "relay.membership".into(),
                "there is no domain for it; say which in domain, or remove it".into(),
            ));
        }
        for (i, topic) in self.topics.iter().enumerate() {
            if topic.duplicate && self.links.len() < 2 {
                let reason = "there is no second link for it; add one to links, or remove this".into();
                return Err((format!("topics[{i}].duplicate"), reason));
            }
            let same = |other: &TopicConfig| other.topic == topic.topic && other.direction == topic.direction;
            if let Some(first) = self.topics[..i].iter().position(same) {
                let reason =
                    format!("{} is already topics[{first}], in the same direction; remove one of them", topic.topic);
                return Err((format!("topics[{i}].topic"), reason));
            }
        }
        Ok(())
    }

    fn resolve(&mut self, folder: &Path) {
        // An absolute path stays what it is.
        let resolve = |path: &mut PathBuf| *path = folder.join(&path);
        resolve(&mut self.identity);
        self.state.as_mut().map(resolve);
        if let Some(domain) = &mut self.domain {
            [&mut domain.card, &mut domain.membership].into_iter().chain(&mut domain.peers).for_each(resolve);
        }
        if let Some(relay) = &mut self.relay {
            resolve(&mut relay.identity);
            if self.domain.is_some() {
                resolve(relay.membership.get_or_insert_with(|| "relay.member".into()));
            }
        }
        for topic in &mut self.topics {
            resolve(&mut topic.card);
            resolve(&mut topic.cert);
        }
    }
}

fn from_text<'de, D: Deserializer<'de>>(deserializer: D) -> Result<LinkTarget, D::Error> {
    String::deserialize(deserializer)?.parse().map_err(de::Error::custom)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros2::{Durability, Reliability};

    const MINIMAL: &str = "{identity: robot.pem, links: [{to: 'eth://r0'}], topics: [{topic: /chatter, direction: out, \
                           card: chatter.card, cert: /etc/gdp/chatter.ad}]}";

    #[test]
    fn a_membership_is_in_files_beside_the_configuration() {
        let text =
            "{identity: robot.pem, links: [{to: 'eth://r0'}], domain: {card: domain.card, membership: /m, peers: [p]}}";
        let config = Config::parse(text, Path::new("/etc/gdp/proxy.yaml")).unwrap();
        let files = PaperFiles::from(config.domain.as_ref().unwrap());
        assert_eq!(
            (files.card.as_path(), files.membership.as_path()),
            (Path::new("/etc/gdp/domain.card"), Path::new("/m"))
        );
        assert_eq!(files.peers, [Path::new("/etc/gdp/p")]);
        let wrong = Config::parse(&text.replace("peers", "peer"), Path::new("p.yaml")).unwrap_err();
        assert!(wrong.to_string().contains("peer"), "{wrong}");
    }

    #[test]
    fn what_is_not_said_has_the_defaults_of_ros_2() {
        let config = parse(MINIMAL).unwrap();
        assert_eq!((config.domain_id.get(), config.links[0].switch, config.links[0].budget), (0, None, None));
        let topic = &config.topics[0];
        assert!(!topic.duplicate);
        assert_eq!((topic.direction, &topic.kind), (Direction::Out, &None));
        assert_eq!((topic.qos.reliability, topic.qos.durability), (Reliability::Reliable, Durability::Volatile));
        assert_eq!(topic.qos.depth.get(), 10);
    }

    #[test]
    fn a_relay_is_said_in_a_word_or_with_what_differs() {
        let relay = |says: &str| parse(&MINIMAL.replace("topics:", &format!("relay: {says}, topics:"))).unwrap().relay;
        assert!(relay("false").is_none() && parse(MINIMAL).unwrap().relay.is_none());
        let plain = relay("true").unwrap();
        assert_eq!(plain.identity, Path::new("/etc/robot/relay.pem"));
        assert_eq!((plain.membership, plain.udp), (None, "0.0.0.0:31415".parse().unwrap()));
        let other = relay("{udp: '[::]:9', interfaces: [r1]}").unwrap();
        assert_eq!((other.udp, other.interfaces), ("[::]:9".parse().unwrap(), vec!["r1".to_owned()]));
        let member = relay("true, domain: {card: c, membership: m}").unwrap();
        assert_eq!(member.membership.as_deref(), Some(Path::new("/etc/robot/relay.member")));
    }

    #[test]
    fn paths_are_relative_to_the_file() {
        let config = parse(MINIMAL).unwrap();
        assert_eq!(config.identity, Path::new("/etc/robot/robot.pem"));
        assert_eq!(config.topics[0].card, Path::new("/etc/robot/chatter.card"));
        assert_eq!(config.topics[0].cert, Path::new("/etc/gdp/chatter.ad"));
    }

    #[test]
    fn everything_can_be_said() {
        let name = "1234e5".repeat(11)[..64].to_owned();
        let text = format!(
            "identity: a.pem\nlinks:\n  - to: udp://127.0.0.1:31415%wlan0\n    switch: {name}\n  - {{to: eth://r0, budget: 250000}}\n\
             domain_id: 42\ntopics:\n  - topic: /a/b\n    type: sensor_msgs/msg/Image\n    direction: in\n    card: c\n    \
             cert: d\n    duplicate: true\n    qos: {{reliability: best_effort, \
             durability: transient_local, depth: 3}}\n"
        );
        let config = parse(&text).unwrap();
        let [first, second] = &config.links[..] else { panic!("{:?}", config.links) };
        assert_eq!(
            (first.switch.unwrap().to_string(), first.to.to_string()),
            (name, "udp://127.0.0.1:31415%wlan0".into())
        );
        assert_eq!(LinkConfig::from(second).budget, Some(250_000));
        assert_eq!(config.domain_id.get(), 42);
        let topic = &config.topics[0];
        assert_eq!(topic.kind.as_ref().unwrap().as_str(), "sensor_msgs/msg/Image");
        assert_eq!((topic.direction, topic.duplicate), (Direction::In, true));
        assert_eq!((topic.qos.reliability, topic.qos.depth.get()), (Reliability::BestEffort, 3));
        assert_eq!(topic.qos.durability, Durability::TransientLocal);
    }

    #[test]
    fn the_example_is_a_configuration() {
        let config = parse(include_str!("../example.yaml")).unwrap();
        assert_eq!(config.topics.iter().map(|t| t.direction).collect::<Vec<_>>(), [Direction::Out, Direction::In]);
    }

    #[test]
    fn nothing_is_exposed_by_default() {
        assert!(parse("{identity: a.pem, links: [{to: 'eth://r0'}]}").unwrap().topics.is_empty());
    }

    /// Each refusal names the file, and what is wrong.
    #[test]
    fn what_is_wrong_is_refused_and_named() {
        let cases = [
            ("", "unexpected end of input"),
            ("{links: [{to: 'eth://r0'}]}", "identity"),
            ("{identity: a.pem}", "links"),
            ("{identity: a.pem, links: []}", "links: 0 of them"),
            (&format!("{{identity: a.pem, links: [{}]}}", "{to: 'eth://r0'}, ".repeat(5)), "links: 5 of them"),
            (
                "{identity: a.pem, links: [{to: 'eth://r0'}, {to: 'eth://r0'}]}",
                "links[1].to: eth://r0 is already links[0]",
            ),
            (&MINIMAL.replace("links:", "lnks:"), "lnks"),
            (&MINIMAL.replace("to:", "via:"), "via"),
            (&MINIMAL.replace("to: 'eth://r0'", "to: 'eth://r0', budget: 0"), "nonzero"),
            (
                &MINIMAL.replace("direction:", "duplicate: true, direction:"),
                "topics[0].duplicate: there is no second link",
            ),
            (&MINIMAL.replace("direction:", "duplicate: twice, direction:"), "boolean"),
            (&MINIMAL.replace("eth://r0", "tcp://r0"), "is no link"),
            (&MINIMAL.replace("cert:", "certs:"), "certs"),
            (&MINIMAL.replace("cert:", "key: chatter.key, cert:"), "no `key` any more"),
            (&MINIMAL.replace("direction: out", "direction: both"), "both"),
            (&MINIMAL.replace("/chatter", "chatter"), "leading slash"),
            (&MINIMAL.replace("direction:", "type: std_msgs/String, direction:"), "package/msg/Name"),
            (&MINIMAL.replace("direction:", "qos: {depth: 0}, direction:"), "a depth of 0"),
            (&MINIMAL.replace("direction:", "qos: {reliability: maybe}, direction:"), "maybe"),
            (&MINIMAL.replace("direction:", "qos: {lifespan: 1}, direction:"), "lifespan"),
            (&MINIMAL.replace("topics:", "domain_id: 233, topics:"), "ROS_DOMAIN_ID"),
            (&MINIMAL.replace("topics:", "relay: maybe, topics:"), "true, false, or a mapping"),
            (&MINIMAL.replace("topics:", "relay: {upd: '[::]:1'}, topics:"), "upd"),
            (&MINIMAL.replace("topics:", "relay: {membership: m}, topics:"), "relay.membership: there is no domain"),
            (&MINIMAL.replace("to:", "switch: 75e1, to:"), "64 hex digits"),
            (&MINIMAL.replace("links:", "identity: b.pem, links:"), "identity"),
            ("[", "robot.yaml"),
        ];
        for (text, expected) in cases {
            let refusal = parse(text).unwrap_err().to_string();
            assert!(refusal.starts_with("/etc/robot/robot.yaml: ") && refusal.contains(expected), "{text}\n{refusal}");
        }
    }

    #[test]
    fn a_secret_given_by_mistake_is_not_shown() {
        let secret = "48d8213db8363f046333e2cf07e9829ee40dd8e94122a74f3d5e0e5b1d7aa5ca";
        for text in [secret, &format!("-----BEGIN PRIVATE KEY-----\n{secret}\n-----END PRIVATE KEY-----\n")] {
            let refusal = parse(text).unwrap_err().to_string();
            assert!(refusal.contains("line 1") && !refusal.contains(&secret[..8]), "{refusal}");
        }
    }

    #[test]
    fn a_topic_is_listed_once_per_direction() {
        let topic = &MINIMAL[MINIMAL.find("{topic").unwrap()..MINIMAL.len() - 2];
        let twice = |second: &str| MINIMAL.replace(topic, &format!("{topic}, {second}"));
        let refusal = parse(&twice(topic)).unwrap_err().to_string();
        assert!(refusal.contains("topics[1].topic: /chatter is already topics[0]"), "{refusal}");
        assert_eq!(parse(&twice(&topic.replace("out", "in"))).unwrap().topics.len(), 2);
    }

    #[test]
    fn a_missing_or_endless_file_is_refused() {
        let missing = Config::load(Path::new("/nonexistent/robot.yaml")).unwrap_err().to_string();
        assert!(missing.starts_with("/nonexistent/robot.yaml: cannot be read"), "{missing}");
        assert!(matches!(Config::load(Path::new("/dev/zero")), Err(ConfigError::TooLong(_))));
    }

    fn parse(text: &str) -> Result<Config, ConfigError> {
        Config::parse(text, Path::new("/etc/robot/robot.yaml"))
    }
}
