//! The configuration of one topic.

use std::num::NonZeroU32;
use std::path::{Path, PathBuf};

use gdp_msg::Encoding;
use gdp_ros::roster::Dialect;
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize, de};

use super::{FramePrefix, Graphs};
use crate::ros2::{Qos, TopicName, TypeName};

/// One topic to carry.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TopicConfig {
    /// Name in the local ROS graph.
    pub topic: TopicName,
    /// Name of the graph, if there are several.
    #[serde(default)]
    pub graph: Option<String>,
    /// The type as ROS 2 writes it, in either graph. If absent: the type in the name card, or else
    /// the type that the publishers use.
    #[serde(default, rename = "type")]
    pub kind: Option<TypeName>,
    /// Where messages go.
    pub direction: Direction,
    /// The topic's name card (`gdp-ctl name create`).
    pub card: PathBuf,
    /// The owner's certificate for this proxy to publish (`gdp-ctl grant add --publish`), followed
    /// by the certificates that it rests on, such as a delegation. For `out` and `both`.
    #[serde(default)]
    pub cert: Option<PathBuf>,
    /// The owner's grant to read (`gdp-ctl grant add --read`), likewise. For `in` and `both`.
    #[serde(default)]
    pub grant: Option<PathBuf>,
    /// QoS of the topic. If absent: the QoS that each publisher offers.
    #[serde(default)]
    pub qos: Option<Qos>,
    /// Encoding into which outgoing messages are converted.
    #[serde(default)]
    pub encoding: Conversion,
    /// Compression of outgoing messages after their conversion, if it makes them shorter. Readers
    /// decompress them whatever value they have here.
    #[serde(default)]
    pub compression: Compression,
    /// Prefix of each `frame_id` of a header and each `child_frame_id`, applied `out` or `in`. It
    /// distinguishes the frames of several robots.
    #[serde(default)]
    pub frame_prefix: Option<FramePrefix>,
    /// Maximum rate of each publisher in messages per second. Of the messages above this rate, only
    /// the newest is sent, at its turn.
    #[serde(default)]
    pub max_hz: Option<NonZeroU32>,
    /// Traffic class of outgoing messages.
    #[serde(default)]
    pub priority: Priority,
    /// Carries the topic over two links at once, so that no message is lost when one fails. `out`:
    /// the second link gets a copy of each frame; `in`: messages arrive over both.
    #[serde(default)]
    pub duplicate: bool,
    /// The name of an imported topic that merges with others of the same local name.
    #[serde(skip)]
    #[schemars(skip)]
    pub merged: Option<Name>,
    /// Refused with the remedy, because earlier versions shared a secret file here.
    #[serde(default, rename = "key", deserialize_with = "no_key")]
    #[schemars(skip)]
    pub(super) _key: (),
    /// Refused with the remedy: only `expose` has readers, because it has a key of the owner.
    #[serde(default, rename = "readers", deserialize_with = "no_readers")]
    #[schemars(skip)]
    pub(super) _readers: (),
    /// Refused with the remedy, as only `expose` makes name cards.
    #[serde(default, rename = "meta", deserialize_with = "no_meta")]
    #[schemars(skip)]
    pub(super) _meta: (),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    /// From local ROS nodes into the fabric.
    Out,
    /// From the fabric to local ROS nodes.
    In,
    Both,
}

/// One direction of a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    Out,
    In,
}

impl From<Side> for Direction {
    fn from(side: Side) -> Self {
        match side {
            Side::Out => Self::Out,
            Side::In => Self::In,
        }
    }
}

/// Encoding of messages between proxies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Conversion {
    /// The native encoding of the graph's ROS version.
    #[default]
    Auto,
    Cdr,
    Ros1,
    Json,
}

/// Compression of messages between proxies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Compression {
    #[default]
    None,
    Zstd,
}

impl Conversion {
    /// Returns the encoding between proxies of messages of a graph of this dialect.
    pub fn encoding(self, dialect: Dialect) -> Encoding {
        match self {
            Self::Auto => dialect.native(),
            Self::Cdr => Encoding::Cdr,
            Self::Ros1 => Encoding::Ros1,
            Self::Json => Encoding::Json,
        }
    }
}

/// A traffic class from 0 to 7: higher classes are sent first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(try_from = "u64")]
pub struct Priority(u8);

impl Priority {
    pub fn get(self) -> u8 {
        self.0
    }
}

impl Default for Priority {
    fn default() -> Self {
        Self(3)
    }
}

impl TryFrom<u64> for Priority {
    type Error = String;

    fn try_from(class: u64) -> Result<Self, String> {
        match u8::try_from(class) {
            Ok(class @ 0..=7) => Ok(Self(class)),
            _ => Err(format!("there is no priority {class}: write 0 to 7, of which 7 goes first")),
        }
    }
}

impl Direction {
    pub fn sides(self) -> &'static [Side] {
        match self {
            Self::Out => &[Side::Out],
            Self::In => &[Side::In],
            Self::Both => &[Side::Out, Side::In],
        }
    }
}

impl TopicConfig {
    /// Returns a topic without files and with default options, for a topic that matches a pattern.
    pub(super) fn without_files(topic: TopicName, direction: Direction) -> Self {
        Self {
            topic,
            graph: None,
            kind: None,
            direction,
            card: PathBuf::new(),
            cert: None,
            grant: None,
            qos: None,
            encoding: Conversion::default(),
            compression: Compression::default(),
            frame_prefix: None,
            max_hz: None,
            priority: Priority::default(),
            duplicate: false,
            merged: None,
            _key: (),
            _readers: (),
            _meta: (),
        }
    }

    /// Returns the certificate file of this direction.
    pub fn right(&self, side: Side) -> Option<&Path> {
        match side {
            Side::Out => self.cert.as_deref(),
            Side::In => self.grant.as_deref(),
        }
    }

    /// Checks the entry. Errors come with the key inside the topic.
    pub(super) fn check(&self, graphs: &Graphs) -> Result<(), (&'static str, String)> {
        graphs.get(self.graph.as_deref()).map_err(|reason| ("graph", reason))?;
        let missing = |what| format!("missing: {what}");
        for side in self.direction.sides() {
            match (side, self.right(*side)) {
                (_, Some(_)) => {}
                (Side::Out, None) => {
                    return Err(("cert", missing("the owner's permission to publish (gdp-ctl grant add --publish)")));
                }
                (Side::In, None) => {
                    return Err(("grant", missing("the owner's permission to read (gdp-ctl grant add --read)")));
                }
            }
        }
        let unused = [(Side::Out, "cert"), (Side::In, "grant")]
            .into_iter()
            .find(|(side, _)| self.right(*side).is_some() && !self.direction.sides().contains(side));
        if let Some((_, key)) = unused {
            return Err((key, "is for the other direction; remove it, or write direction: both".into()));
        }
        if self.frame_prefix.is_some() && self.direction == Direction::Both {
            let reason = "with direction: both, frames that come would get it as well as those that go; list the \
                          topic twice, once \
                          out and once in, and say it in one of them";
            return Err(("frame_prefix", reason.into()));
        }
        Ok(())
    }

    /// Whether both carry the same topic of the same graph in a common direction.
    pub(super) fn overlaps(&self, other: &Self, graphs: &Graphs) -> bool {
        let sides = other.direction.sides();
        let graph = |topic: &Self| graphs.get(topic.graph.as_deref()).ok().map(|(name, _)| name.to_owned());
        (graph(self), &self.topic) == (graph(other), &other.topic)
            && self.direction.sides().iter().any(|side| sides.contains(side))
    }
}

fn no_key<'de, D: Deserializer<'de>>(_: D) -> Result<(), D::Error> {
    Err(de::Error::custom(
        "there is no `key` any more: writers give each reader its keys. Remove it here, and the file on every machine",
    ))
}

fn no_readers<'de, D: Deserializer<'de>>(_: D) -> Result<(), D::Error> {
    Err(de::Error::custom(
        "`readers` is a key of `expose` alone, for which the proxy has an owner's key. Who may read a topic that is \
         listed, its owner's \
         grants say: remove it here, and give each reader one (gdp-ctl grant add --read)",
    ))
}

fn no_meta<'de, D: Deserializer<'de>>(_: D) -> Result<(), D::Error> {
    Err(de::Error::custom(
        "`meta` is a key of `expose` alone, for which the proxy makes the name cards. The metadata of a topic that \
         is listed is in the card \
         that `card` names: remove it here, and say it when the name is made, for other metadata makes another name (gdp-ctl name create --meta)",
    ))
}
