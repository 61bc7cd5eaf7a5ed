//! Patterns of ROS names.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, de};

use super::{Thing, What};
use crate::ros2::TopicName;

const MAX_PATTERN: usize = 253;

/// A name with a leading slash, in which `*` stands for any characters of one segment, and a
/// segment `**` for any number of segments, also none: `/camera/**` is `/camera` and all beneath
/// it, `/*/image_*` is `/left/image_raw`.
#[derive(Clone, Debug, PartialEq, Eq, JsonSchema)]
pub struct Pattern(String);

impl Pattern {
    pub fn parse(text: &str) -> Result<Self, String> {
        let good = |segment: &str| {
            segment == "**" || !segment.is_empty() && !segment.contains("**") && segment.chars().all(is_part)
        };
        let well_formed = text.strip_prefix('/').is_some_and(|rest| rest.split('/').all(good));
        if well_formed && text.len() <= MAX_PATTERN {
            return Ok(Self(text.into()));
        }
        let text: String = text.chars().take(64).collect();
        Err(format!(
            "{text:?} is no pattern of names: write a name with a leading slash, in which * stands for any \
             characters between two slashes and /** for \
             any number of segments, such as /camera/** or /*/odom"
        ))
    }

    /// Whether the name is one of those meant. [Hidden](is_hidden) ones are meant only by a pattern
    /// that is their name.
    pub fn matches(&self, thing: Thing, name: &TopicName) -> bool {
        if is_hidden(thing, name) { self.0 == name.as_str() } else { self.covers(name) }
    }

    /// The same, hidden or not: what is denied is denied.
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

/// What ROS and proxies have for themselves: `/rosout`, `/rosout_agg`, `/parameter_events`,
/// `/gdp_proxy…`, names with a segment that begins with an underscore, and the services that nodes
/// have without being asked to, which read and set their parameters and log levels.
pub fn is_hidden(thing: Thing, name: &TopicName) -> bool {
    let name = name.as_str();
    matches!(name, "/rosout" | "/rosout_agg" | "/parameter_events")
        || name.starts_with("/gdp_proxy")
        || segments(name).any(|segment| segment.starts_with('_'))
        || thing == Thing::Call(What::Service) && segments(name).last().is_some_and(is_of_every_node)
}

fn is_of_every_node(last: &str) -> bool {
    // Also `set_parameters_atomically`.
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

fn is_part(c: char) -> bool {
    c.is_ascii_alphanumeric() || matches!(c, '_' | '*')
}

/// Whether the text is one of the pattern's, where what `is_any` holds of stands for any number of
/// parts. In time of the product of their lengths: only the last such part is ever tried again,
/// with one more.
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
