//! The kinds of named entities of a ROS graph.

use super::What;
use crate::ros2::{TopicName, TypeName};

/// The kind of an entity to carry: a topic, a service or an action.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Thing {
    Topic,
    Call(What),
}

impl Thing {
    pub const ALL: [Self; 3] = [Self::Topic, Self::Call(What::Service), Self::Call(What::Action)];

    /// Returns the kind of its name card.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Topic => "topic",
            Self::Call(what) => what.as_str(),
        }
    }

    /// Parses the kind of a name card. Returns `None` for a kind that this release does not know.
    pub fn parse(kind: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|thing| thing.as_str() == kind)
    }

    /// Returns the list of the configuration that contains it.
    pub fn list(self) -> &'static str {
        match self {
            Self::Topic => "topics",
            Self::Call(what) => what.list(),
        }
    }

    /// Returns the entity's title in the log.
    pub fn title(self, name: &TopicName) -> String {
        format!("{} {name}", self.as_str())
    }

    /// Whether the entity can have this type. A topic must have one. The type of a service or
    /// action may be learnt from its servers.
    pub fn fits(self, kind: Option<&TypeName>) -> bool {
        match (self, kind) {
            (Self::Topic, kind) => kind.is_some(),
            (Self::Call(what), Some(kind)) => what.fits(kind),
            (Self::Call(_), None) => true,
        }
    }
}
