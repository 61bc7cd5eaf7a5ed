//! Patterns of ROS names.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, de};

use super::{Thing, What};
use crate::ros2::TopicName;

/// A pattern of names with a leading slash. `*` matches any characters within a segment. A segment
/// `**` matches any number of segments, including none. `/camera/**` matches `/camera` and
/// everything beneath it; `/*/image_*` matches `/left/image_raw`.
#[derive(Clone, Debug, PartialEq, Eq, JsonSchema)]
pub struct Pattern(String);

impl Pattern {
    pub fn parse(text: &str) -> Result<Self, String> {
        gdp_ros::pattern::check(text).map(|()| Self(text.into()))
    }

    /// Whether the pattern selects the name. [Hidden](is_hidden) names are selected only by a
    /// pattern that equals the name. A service that every node has is also selected by a pattern
    /// whose last segment names it, such as `/**/list_parameters`.
    pub fn matches(&self, thing: Thing, name: &TopicName) -> bool {
        if !is_hidden(thing, name) {
            return self.covers(name);
        }
        let (pattern, hidden) = (segments(&self.0).last(), segments(name.as_str()).last());
        let is_named = hidden.is_some_and(is_of_every_node) && thing == Thing::Call(What::Service) && pattern == hidden;
        self.0 == name.as_str() || (is_named && self.covers(name))
    }

    /// Whether the pattern matches the name, hidden or not. Denials use it.
    pub fn covers(&self, topic: &TopicName) -> bool {
        let (pattern, name): (Vec<&str>, Vec<&str>) = (segments(&self.0).collect(), segments(topic.as_str()).collect());
        glob(
            &pattern,
            &name,
            |part| *part == "**",
            |part, segment| glob(part.as_bytes(), segment.as_bytes(), |c| *c == b'*', u8::eq),
        )
    }
}

/// Whether a name is one that ROS or proxies use internally. These are `/rosout`, `/rosout_agg`,
/// `/parameter_events`, `/clock` (the time of all nodes), `/gdp_proxy…`, and names with a segment
/// that begins with an underscore.
/// Also the services by which every node reads and sets its parameters and log levels.
pub fn is_hidden(thing: Thing, name: &TopicName) -> bool {
    let name = name.as_str();
    matches!(name, "/rosout" | "/rosout_agg" | "/parameter_events" | "/clock")
        || name.starts_with("/gdp_proxy")
        || segments(name).any(|segment| segment.starts_with('_'))
        || thing == Thing::Call(What::Service) && segments(name).last().is_some_and(is_of_every_node)
}

fn is_of_every_node(last: &str) -> bool {
    // This also matches `set_parameters_atomically`.
    last.starts_with("set_parameters")
        || matches!(
            last,
            "get_parameters"
                | "describe_parameters"
                | "list_parameters"
                | "get_parameter_types"
                | "get_type_description"
                | "get_logger_levels"
                | "set_logger_levels"
                | "get_loggers"
                | "set_logger_level"
        )
}

fn segments(name: &str) -> impl Iterator<Item = &str> {
    name.split('/').skip(1)
}

/// Whether the pattern matches the text. A part for which `is_any` is true matches any number of
/// parts. It takes time proportional to the product of both lengths, because it backtracks only to
/// the last such part.
fn glob<P, T>(pattern: &[P], text: &[T], is_any: impl Fn(&P) -> bool, is_one: impl Fn(&P, &T) -> bool) -> bool {
    let (mut p, mut t, mut last) = (0, 0, None);
    while t < text.len() {
        match pattern.get(p) {
            Some(part) if is_any(part) => {
                last = Some((p, t));
                p += 1;
            }
            Some(part) if is_one(part, &text[t]) => (p, t) = (p + 1, t + 1),
            _ => match last {
                Some((any, from)) => {
                    last = Some((any, from + 1));
                    (p, t) = (any + 1, from + 1);
                }
                None => return false,
            },
        }
    }
    pattern[p..].iter().all(is_any)
}

impl fmt::Display for Pattern {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl<'de> Deserialize<'de> for Pattern {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Self::parse(&String::deserialize(deserializer)?).map_err(de::Error::custom)
    }
}

#[cfg(test)]
#[path = "../../tests/unit/config/pattern.rs"]
mod tests;
