//! The configuration file: the topics, services and actions to carry, their directions and their
//! keys. It is strict, because a misspelt key in a file about permissions must not pass for a
//! default. The default exposes nothing.
//!
//! This module reads only this file. [`crate::material`] reads the files that it names.

mod action_topic;
mod automatic;
mod call_kind;
mod calls;
mod frames;
mod graphs;
mod pattern;
mod relay;
mod schema;
mod shared;
mod thing;
mod topics;

use std::io;
use std::net::SocketAddr;
use std::num::NonZeroU64;
use std::path::{Path, PathBuf};

use gdp::unstable::LinkConfig;
use gdp_core::crypto::Backend;
use gdp_core::domain::CredentialFiles;
use gdp_core::file_kind::FileKind;
use gdp_core::link_target::LinkTarget;
use gdp_core::peer::MAX_LANES;
use gdp_ros::roster::Dialect;
use gdp_util::{text_file, yaml};
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, de};

pub use self::action_topic::{action_of_topic, action_type};
pub use self::automatic::{ExposeConfig, ImportConfig, ReaderConfig, Remap, Rule, RuleOptions, remapped};
pub use self::calls::CallConfig;
pub use self::frames::FramePrefix;
pub use self::graphs::{DomainId, GraphConfig, Graphs, Ros1Config, Ros2Config, ZenohConfig};
pub use self::pattern::{Pattern, is_hidden};
pub use self::relay::RelayConfig;
pub use self::schema::schema;
pub use self::shared::{MemberReader, PatternsByKind, SharedImport, SharedTopics};
pub use self::thing::Thing;
pub use self::topics::{Compression, Conversion, Direction, Side, TopicConfig};
pub use crate::config::call_kind::What;

/// Bound in bytes on the configuration file.
const MAX_FILE: u64 = 1024 * 1024;

/// Bound on the topics of one proxy, and on its services and actions.
const MAX_TOPICS: usize = 1024;

/// Bound on the imported catalogs of one proxy.
const MAX_IMPORTS: usize = 64;

/// Bound on the topic routes: one for each topic and direction.
pub const MAX_ROUTES: usize = 2 * MAX_TOPICS;

/// Bound on the services and actions together.
pub const MAX_CALLS: usize = 2 * MAX_TOPICS;

#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Version of the file's format.
    #[serde(rename = "version")]
    _version: Version,
    /// The proxy's private key (`gdp-ctl key generate FILE --kind proxy`).
    pub identity: PathBuf,
    /// The links to the fabric, in order of preference: all traffic takes the first link that is
    /// up.
    pub links: Vec<LinkEntry>,
    /// A folder for state that must survive a restart: the revocations of owners. The proxy creates
    /// it.
    #[serde(default)]
    pub state: Option<PathBuf>,
    /// The trust domain of which the proxy is a member.
    #[serde(default)]
    pub domain: Option<DomainConfig>,
    /// The domain's directory, which lists what its members share (`gdp-proxy join` writes this).
    #[serde(default)]
    pub directory: Option<DirectoryConfig>,
    /// A switch beside the proxy that carries other endpoints.
    #[serde(default, deserialize_with = "relay::relay")]
    #[schemars(schema_with = "relay::schema")]
    pub relay: Option<RelayConfig>,
    /// What seals and signs messages and verifies signatures, if it is not the default:
    /// `aws-lc` or `rustcrypto`. Everything else is RustCrypto's in any case.
    #[serde(default)]
    #[schemars(schema_with = "schema::crypto")]
    pub crypto: Option<Backend>,
    /// The ROS graphs of the proxy.
    #[serde(default)]
    pub graphs: Graphs,
    /// Definitions of message types beyond the common ones.
    #[serde(default)]
    pub definitions: Definitions,
    /// Publishes the status of each topic on `/diagnostics` in each graph. On by default.
    #[serde(default = "yes")]
    pub diagnostics: bool,
    /// The path of the admin socket, which `gdp-ctl status` and `top` ask. By default
    /// `/run/gdp/proxy.sock` for root, else `$XDG_RUNTIME_DIR/gdp/proxy.sock`.
    #[serde(default)]
    pub socket: Option<PathBuf>,
    /// Address and port of metrics in OpenMetrics, such as `127.0.0.1:9405`, or a port alone for
    /// loopback. Off by default.
    #[serde(default, deserialize_with = "metrics_address")]
    #[schemars(with = "Option<String>")]
    pub metrics: Option<SocketAddr>,
    /// File of the token that a scrape needs: `Authorization: Bearer TOKEN`. An address that other
    /// machines reach needs one.
    #[serde(default)]
    pub metrics_token: Option<PathBuf>,
    /// The topics to carry, with their files.
    #[serde(default)]
    pub topics: Vec<TopicConfig>,
    /// The local topics, services and actions to expose by pattern.
    #[serde(default)]
    pub expose: Option<ExposeConfig>,
    /// The remote topics, services and actions to import by pattern.
    #[serde(default)]
    pub import: Vec<ImportConfig>,
    /// The services to carry, with their files.
    #[serde(default, deserialize_with = "calls::list::<_, calls::Service>")]
    #[schemars(with = "Vec<calls::Service>")]
    pub services: Vec<CallConfig>,
    /// The actions to carry, with their files.
    #[serde(default, deserialize_with = "calls::list::<_, calls::Action>")]
    #[schemars(with = "Vec<calls::Action>")]
    pub actions: Vec<CallConfig>,
}

/// The only known version, 1.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(try_from = "u64")]
struct Version;

impl TryFrom<u64> for Version {
    type Error = String;

    fn try_from(version: u64) -> Result<Self, String> {
        match version {
            1 => Ok(Self),
            other => {
                Err(format!("version {other} of the configuration is not known to this release; write version: 1"))
            }
        }
    }
}

/// The files that make the proxy a member of a trust domain (`gdp-ctl domain`).
#[derive(Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DomainConfig {
    /// The domain's card.
    pub card: PathBuf,
    /// The proxy's membership. The proxy reads it again when it changes, as the other files.
    pub membership: PathBuf,
    /// The PeerCerts of the domain, which give rights to other domains that the robot visits
    /// (`gdp-ctl domain peer`).
    #[serde(default)]
    pub peers: Vec<PathBuf>,
}

/// The directory of the proxy's domain.
#[derive(Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DirectoryConfig {
    /// The card of the directory's name.
    pub card: PathBuf,
    /// The grant to read the directory.
    pub grant: PathBuf,
    /// Exposes what other members import from this one: `/LABEL/TOPIC`, with the other's label. The
    /// proxy of a server does.
    #[serde(default)]
    pub export: bool,
    /// Name of the graph in which members' topics appear, if there are several.
    #[serde(default)]
    pub graph: Option<String>,
}

impl From<&DomainConfig> for CredentialFiles {
    fn from(config: &DomainConfig) -> Self {
        let DomainConfig { card, membership, peers } = config;
        Self { card: card.clone(), membership: membership.clone(), peers: peers.clone() }
    }
}

/// `share` folders of ROS installations, with a folder for each package.
#[derive(Debug, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Definitions {
    /// Folders of ROS 1.
    pub ros1: Vec<PathBuf>,
    /// Folders of ROS 2.
    pub ros2: Vec<PathBuf>,
}

impl Definitions {
    pub fn folders(&self) -> impl Iterator<Item = (Dialect, &Path)> {
        let ros1 = self.ros1.iter().map(|folder| (Dialect::Ros1, folder.as_path()));
        ros1.chain(self.ros2.iter().map(|folder| (Dialect::Ros2, folder.as_path())))
    }
}

/// One link to the fabric.
#[derive(Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LinkEntry {
    /// Address of the switch: `eth://INTERFACE`, `eth://INTERFACE/MAC`, `udp://HOST:PORT`,
    /// `udp://HOST:PORT%INTERFACE`, `tls://HOST:PORT` or `wss://HOST:PORT`. A link over TLS after
    /// another link is used only while no earlier one is up.
    #[serde(deserialize_with = "from_text")]
    #[schemars(with = "String")]
    pub to: LinkTarget,
    /// Name of the switch that must answer. If absent: any switch.
    #[serde(default)]
    #[schemars(with = "Option<String>")]
    pub switch: Option<Name>,
    /// Bound in bytes per second on what topics send over this link.
    #[serde(default)]
    pub budget: Option<NonZeroU64>,
}

impl From<&LinkEntry> for LinkConfig {
    fn from(place: &LinkEntry) -> Self {
        let LinkEntry { to, switch, budget } = place;
        Self { target: to.clone(), switch: *switch, budget: budget.map(NonZeroU64::get) }
    }
}

/// Errors of a configuration file. Every text begins with the file.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    #[error("{}: cannot be read: there is no such file in {}", path.display(), folder.display())]
    Missing { path: PathBuf, folder: PathBuf },
    #[error("{}: cannot be read: {source}", path.display())]
    Io { path: PathBuf, source: io::Error },
    #[error("{}: it is {kind}, not a proxy configuration", path.display())]
    OtherKind { path: PathBuf, kind: FileKind },
    #[error("{}: longer than {MAX_FILE} bytes, so not a proxy configuration", .0.display())]
    TooLong(PathBuf),
    #[error("{}: {message}", path.display())]
    Syntax { path: PathBuf, message: String },
    #[error("{}: {key}: {reason}", path.display())]
    Invalid { path: PathBuf, key: String, reason: String },
}

impl Config {
    /// Reads and checks a file. Relative paths in it are relative to its folder.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let io = |source: io::Error| match std::path::absolute(path) {
            Ok(absolute) if source.kind() == io::ErrorKind::NotFound => {
                let folder = absolute.parent().unwrap_or(&absolute).into();
                ConfigError::Missing { path: path.into(), folder }
            }
            _ => ConfigError::Io { path: path.into(), source },
        };
        let text = text_file::read(path, MAX_FILE).map_err(io)?;
        let text = text.ok_or_else(|| ConfigError::TooLong(path.into()))?;
        Self::parse(&text, path)
    }

    /// Parses and checks a text. `path` is the file that it comes from.
    pub fn parse(text: &str, path: &Path) -> Result<Self, ConfigError> {
        let mut config: Self = yaml::parse(text).map_err(|message| match FileKind::of(text) {
            Some(kind) => ConfigError::OtherKind { path: path.into(), kind },
            None => ConfigError::Syntax { path: path.into(), message },
        })?;
        config.check().map_err(|(key, reason)| ConfigError::Invalid { path: path.into(), key, reason })?;
        config.resolve(path.parent().unwrap_or(Path::new("")));
        Ok(config)
    }

    /// Returns the first key that differs in `new` and cannot change while the proxy runs. Graphs
    /// may be added.
    pub fn fixed_that_differs(&self, new: &Self) -> Option<String> {
        let differs = [
            ("identity", self.identity != new.identity),
            ("links", self.links != new.links),
            ("state", self.state != new.state),
            ("domain", self.domain != new.domain),
            ("directory", self.directory != new.directory),
            ("crypto", new.crypto.is_some_and(|new| new != Backend::selected())),
            ("relay", self.relay != new.relay),
            ("definitions", self.definitions != new.definitions),
            ("socket", self.socket != new.socket),
            ("metrics", self.metrics != new.metrics),
            ("metrics_token", self.metrics_token != new.metrics_token),
        ];
        let differs = differs.into_iter().find_map(|(key, differs)| differs.then(|| key.to_owned()));
        let stays = |(name, graph): &(&str, &GraphConfig)| new.graphs.get(Some(name)).is_ok_and(|(_, it)| it == *graph);
        let graph = || self.graphs.iter().find(|graph| !stays(graph)).map(|(name, _)| format!("graphs.{name}"));
        differs.or_else(graph)
    }

    fn check(&self) -> Result<(), (String, String)> {
        let lists = [("topics", self.topics.len()), ("services", self.services.len()), ("actions", self.actions.len())];
        if let Some((key, _)) = lists.into_iter().find(|(_, length)| *length > MAX_TOPICS) {
            return Err((key.into(), format!("more than {MAX_TOPICS}; run a second proxy")));
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
        if let Some(directory) = &self.directory {
            if self.domain.is_none() {
                return Err((
                    "directory".into(),
                    "there is no domain for it; say which in domain, or remove it".into(),
                ));
            }
            self.graphs.get(directory.graph.as_deref()).map_err(|reason| ("directory.graph".into(), reason))?;
        }
        for (i, topic) in self.topics.iter().enumerate() {
            let wrong = |key: &str, reason: String| (format!("topics[{i}].{key}"), reason);
            topic.check(&self.graphs).map_err(|(key, reason)| wrong(key, reason))?;
            if topic.duplicate {
                self.check_second_link().map_err(|reason| wrong("duplicate", reason))?;
            }
            if let Some(first) = self.topics[..i].iter().position(|other| other.overlaps(topic, &self.graphs)) {
                let reason =
                    format!("{} is already topics[{first}], in the same direction; remove one of them", topic.topic);
                return Err(wrong("topic", reason));
            }
        }
        if let Some(expose) = &self.expose {
            expose
                .check(&self.graphs, self.directory.is_some())
                .map_err(|(key, reason)| (format!("expose.{key}"), reason))?;
            if expose.duplicates() {
                self.check_second_link().map_err(|reason| ("expose".into(), reason))?;
            }
        }
        if self.import.len() > MAX_IMPORTS {
            return Err(("import".into(), format!("more than {MAX_IMPORTS}; run a second proxy")));
        }
        for (i, import) in self.import.iter().enumerate() {
            import.check(&self.graphs).map_err(|(key, reason)| (format!("import[{i}].{key}"), reason))?;
            if import.duplicate {
                self.check_second_link().map_err(|reason| (format!("import[{i}].duplicate"), reason))?;
            }
            if let Some(first) = self.import[..i].iter().position(|other| other.catalog == import.catalog) {
                let reason = format!("is already that of import[{first}]; say all that comes of it there");
                return Err((format!("import[{i}].catalog"), reason));
            }
        }
        for calls in [&self.services, &self.actions] {
            for (i, call) in calls.iter().enumerate() {
                let list = call.what.list();
                let wrong = |key: &str, reason: String| (format!("{list}[{i}].{key}"), reason);
                call.check(&self.graphs).map_err(|(key, reason)| wrong(key, reason))?;
                if let Some(first) = calls[..i].iter().position(|other| other.is_same(call, &self.graphs)) {
                    let reason = format!("{} is already {list}[{first}], in this graph; remove one of them", call.name);
                    return Err(wrong(call.what.as_str(), reason));
                }
            }
        }
        Ok(())
    }

    fn check_second_link(&self) -> Result<(), String> {
        match self.links.len() {
            0 | 1 => Err("there is no second link for it; add one to links, or remove this".into()),
            _ => Ok(()),
        }
    }

    /// Returns services and actions, each with its key in the configuration.
    pub fn calls(&self) -> impl Iterator<Item = (String, &CallConfig)> {
        let all = self.services.iter().enumerate().chain(self.actions.iter().enumerate());
        all.map(|(i, call)| (format!("{}[{i}]", call.what.list()), call))
    }

    fn resolve(&mut self, folder: &Path) {
        if let Some(relay) = self.relay.as_mut().filter(|_| self.domain.is_some()) {
            relay.membership.get_or_insert_with(|| "relay.member".into());
        }
        let Definitions { ros1, ros2 } = &mut self.definitions;
        // `join` leaves absolute paths unchanged.
        let resolve = |path: &mut PathBuf| *path = folder.join(&path);
        let kept = self.state.iter_mut().chain(&mut self.socket).chain(&mut self.metrics_token);
        ros1.iter_mut().chain(ros2).chain(kept).for_each(resolve);
        self.files().for_each(resolve);
    }

    /// Returns the paths of all files that the configuration names.
    pub fn files(&mut self) -> impl Iterator<Item = &mut PathBuf> {
        let domain = self.domain.iter_mut().flat_map(|domain| {
            let DomainConfig { card, membership, peers } = domain;
            [card, membership].into_iter().chain(peers)
        });
        let directory = self.directory.iter_mut().flat_map(|directory| [&mut directory.card, &mut directory.grant]);
        let relay =
            self.relay.iter_mut().flat_map(|relay| [&mut relay.identity].into_iter().chain(&mut relay.membership));
        let topics = self.topics.iter_mut();
        let topics =
            topics.flat_map(|topic| [&mut topic.card].into_iter().chain(&mut topic.cert).chain(&mut topic.grant));
        let expose = self.expose.iter_mut().flat_map(|expose| [&mut expose.owner, &mut expose.catalog]);
        let imports = self.import.iter_mut().flat_map(|import| [&mut import.catalog, &mut import.grant]);
        let calls = self.services.iter_mut().chain(&mut self.actions);
        let calls = calls.flat_map(|call| [&mut call.card].into_iter().chain(&mut call.cert).chain(&mut call.grant));
        [&mut self.identity]
            .into_iter()
            .chain(domain)
            .chain(directory)
            .chain(relay)
            .chain(topics)
            .chain(expose)
            .chain(imports)
            .chain(calls)
    }
}

fn yes() -> bool {
    true
}

fn metrics_address<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<SocketAddr>, D::Error> {
    let text = Option::<String>::deserialize(deserializer)?;
    text.map(|text| gdp_http::parse_address(&text)).transpose().map_err(de::Error::custom)
}

fn from_text<'de, D: Deserializer<'de>>(deserializer: D) -> Result<LinkTarget, D::Error> {
    String::deserialize(deserializer)?.parse().map_err(de::Error::custom)
}

#[cfg(test)]
#[path = "../../tests/unit/config/error_messages.rs"]
mod error_messages;
#[cfg(test)]
#[path = "../../tests/unit/config.rs"]
mod tests;
