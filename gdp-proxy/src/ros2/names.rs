//! Maps names of topics and types between ROS 2 and DDS (design.ros2.org, "Topic and Service name
//! mapping to DDS").
//!
//! The texts come from a user's file or from the network. [`gdp_ros::names`] checks all of them.

use std::fmt;

use gdp_ros::names::{self, NameError};
use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, de};

/// A fully qualified topic name: `/chatter`, `/robot1/camera/image_raw`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, JsonSchema)]
pub struct TopicName(String);

/// A message type: `std_msgs/msg/String`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, JsonSchema)]
pub struct TypeName(String);

impl TopicName {
    pub fn parse(text: &str) -> Result<Self, NameError> {
        names::check_topic(text).map(|()| Self(text.to_owned()))
    }

    /// Returns the DDS topic: `rt/chatter`.
    pub fn to_dds(&self) -> String {
        format!("rt{}", self.0)
    }

    /// Returns the DDS topics of the service of this name: requests (`rq/add_two_intsRequest`) and
    /// replies (`rr/add_two_intsReply`).
    pub fn to_dds_service(&self) -> [String; 2] {
        [format!("rq{}Request", self.0), format!("rr{}Reply", self.0)]
    }

    /// Returns the ROS name of a DDS topic and what the topic carries, if ROS 2 created it.
    pub fn from_dds(dds: &str) -> Option<(Part, Self)> {
        let (part, name) = match dds.split_at_checked(2)? {
            ("rt", name) => (Part::Topic, name),
            ("rq", name) => (Part::Requests, name.strip_suffix("Request")?),
            ("rr", name) => (Part::Replies, name.strip_suffix("Reply")?),
            _ => return None,
        };
        Some((part, Self::parse(name).ok()?))
    }

    /// Returns a name beneath this one, such as `/fibonacci` with `_action/status`.
    pub(super) fn join(&self, rest: &str) -> Result<Self, NameError> {
        Self::parse(&format!("{}/{rest}", self.0))
    }

    pub fn as_str(&self) -> &str {
        &self.0
    }
}

/// The kind of messages on a DDS topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    Topic,
    /// Requests of the service with this name.
    Requests,
    Replies,
}

impl TypeName {
    pub fn parse(text: &str) -> Result<Self, NameError> {
        names::check_type(text).map(|_| Self(text.to_owned()))
    }

    /// Returns the type of a DDS type name, if ROS 2 created it: `std_msgs::msg::dds_::String_`.
    pub fn from_dds(dds: &str) -> Result<Self, NameError> {
        let refusal = || NameError::of_type(dds);
        match dds.split("::").collect::<Vec<_>>()[..] {
            [package, kind, "dds_", name] => {
                let name = name.strip_suffix('_').ok_or_else(refusal)?;
                Self::parse(&format!("{package}/{kind}/{name}")).map_err(|_| refusal())
            }
            _ => Err(refusal()),
        }
    }

    /// Returns the types of a service's requests and replies. For
    /// `example_interfaces/srv/AddTwoInts` they are `…_Request` and `…_Response`.
    pub fn of_service(&self) -> [Self; 2] {
        [Self(format!("{}_Request", self.0)), Self(format!("{}_Response", self.0))]
    }

    /// Returns this type without a suffix that ROS gives to generated types.
    pub(super) fn without(&self, ending: &str) -> Option<Self> {
        Self::parse(self.0.strip_suffix(ending)?).ok()
    }

    /// Returns this type with a suffix.
    pub(super) fn with(&self, ending: &str) -> Self {
        Self(format!("{}{ending}", self.0))
    }

    /// Returns the DDS type name: `std_msgs::msg::dds_::String_`.
    pub fn to_dds(&self) -> String {
        let mut parts = self.0.split('/');
        let mut part = || parts.next().unwrap_or_default();
        format!("{}::{}::dds_::{}_", part(), part(), part())
    }

    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Returns the message type as ROS 1 writes it: `std_msgs/String`.
    pub fn to_ros1(&self) -> String {
        self.0.replacen("/msg/", "/", 1)
    }
}

impl fmt::Display for TopicName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl fmt::Display for TypeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl<'de> Deserialize<'de> for TopicName {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Self::parse(&String::deserialize(deserializer)?).map_err(de::Error::custom)
    }
}

impl<'de> Deserialize<'de> for TypeName {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Self::parse(&String::deserialize(deserializer)?).map_err(de::Error::custom)
    }
}

#[cfg(test)]
#[path = "../../tests/unit/ros2/names.rs"]
mod tests;
