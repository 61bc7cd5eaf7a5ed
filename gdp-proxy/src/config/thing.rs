//! The kinds of named entities of a ROS graph.

use super::What;
use crate::ros2::{TopicName, TypeName};

/// What crosses: a topic, or what is called.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Thing {
    Topic,
    Call(What),
}

impl Thing {
    pub const ALL: [Self; 3] = [Self::Topic, Self::Call(What::Service), Self::Call(What::Action)];

    /// The kind of its name card.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Topic => "topic",
            Self::Call(what) => what.as_str(),
        }
    }

    /// Of a name card. None of a kind that this release does not know.
    pub fn parse(kind: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|thing| thing.as_str() == kind)
    }

    /// The list of the configuration that it stands in.
    pub fn list(self) -> &'static str {
        match self {
            Self::Topic => "topics",
            Self::Call(what) => what.list(),
        }
    }

    /// What the log calls one.
    pub fn title(self, name: &TopicName) -> String {
        format!("{} {name}", self.as_str())
    }

    /// Whether it can be of this type. Topics have one; of what is called it may be learnt from the
    /// servers.
    pub fn fits(self, kind: Option<&TypeName>) -> bool {
        match (self, kind) {
            (Self::Topic, kind) => kind.is_some(),
            (Self::Call(what), Some(kind)) => what.fits(kind),
            (Self::Call(_), None) => true,
        }
    }
}
