//! Patterns of ROS names.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, de};

use super::{Thing, What};
use crate::ros2::TopicName;

const MAX_PATTERN: usize = 253;

/// A name with a leading slash, in which `*` stands for any characters of one segment, and a segment `**` for any number of segments, also none:
/// `/camera/**` is `/camera` and all beneath it, `/*/image_*` is `/left/image_raw`.
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
            "{text:?} is no pattern of names: write a name with a leading slash, in which * stands for any characters between two slashes and /** for \
             any number of segments, such as /camera/** or /*/odom"
        ))
    }

    /// Whether the name is one of those meant. [Hidden](is_hidden) ones are meant only by a pattern that is their name.
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

/// What ROS and proxies have for themselves: `/rosout`, `/rosout_agg`, `/parameter_events`, `/gdp_proxy…`, names with a segment that begins with an underscore,
/// and the services that nodes have without being asked to, which read and set their parameters and log levels.
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

/// Whether the text is one of the pattern's, where what `is_any` holds of stands for any number of parts. In time of the product of their lengths:
/// only the last such part is ever tried again, with one more.
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
mod tests {
    use super::*;

    fn matches(pattern: &str, topic: &str) -> bool {
        is_meant(Thing::Topic, pattern, topic)
    }

    fn is_meant(thing: Thing, pattern: &str, name: &str) -> bool {
        Pattern::parse(pattern).unwrap().matches(thing, &TopicName::parse(name).unwrap())
    }

    #[test]
    fn a_star_is_of_one_segment_and_two_are_of_any_number() {
        let cases = [
            ("/chatter", "/chatter", true),
            ("/chatter", "/chatter2", false),
            ("/*", "/chatter", true),
            ("/*", "/a/b", false),
            ("/**", "/a/b/c", true),
            ("/camera/**", "/camera", true),
            ("/camera/**", "/camera/left/image_raw", true),
            ("/camera/**", "/cameras/left", false),
            ("/**/image_raw", "/image_raw", true),
            ("/**/image_raw", "/a/b/image_raw", true),
            ("/**/image_raw", "/a/image_raw/b", false),
            ("/*/image_*", "/left/image_raw", true),
            ("/*/image_*", "/left/right/image_raw", false),
            ("/**/left/**/raw", "/left/left/x/raw", true),
            ("/a*b*c", "/abbc", true),
            ("/a*b*c", "/acb", false),
        ];
        for (pattern, topic, expected) in cases {
            assert_eq!(matches(pattern, topic), expected, "{pattern} {topic}");
        }
    }

    #[test]
    fn what_ros_has_for_itself_is_meant_only_by_its_name() {
        for topic in ["/rosout", "/parameter_events", "/_hidden", "/a/_action/status", "/gdp_proxy", "/gdp_proxy_1"] {
            let any = ["/**", "/*", "/*/**", "/r*", "/a/**"].iter().any(|pattern| matches(pattern, topic));
            assert!(!any && matches(topic, topic), "{topic}");
        }
    }

    #[test]
    fn services_that_every_node_has_are_meant_only_by_their_names() {
        let (service, action) = (Thing::Call(What::Service), Thing::Call(What::Action));
        for last in [
            "get_parameters",
            "set_parameters",
            "set_parameters_atomically",
            "describe_parameters",
            "list_parameters",
            "get_parameter_types",
            "get_type_description",
            "get_loggers",
            "set_logger_level",
            "_action/send_goal",
        ] {
            let name = format!("/a/{last}");
            for pattern in ["/**", "/a/**", "/*/*", "/a/get_*", "/a/*_parameters"] {
                assert!(!is_meant(service, pattern, &name), "{pattern} {name}");
            }
            assert!(is_meant(service, &name, &name), "{name}");
        }
        assert!(is_meant(service, "/**", "/a/get_plan") && is_meant(service, "/**", "/get_parameters/now"));
        assert!(is_meant(action, "/**", "/a/get_parameters") && matches("/**", "/a/get_parameters"));
    }

    #[test]
    fn what_is_no_pattern_is_refused() {
        for text in [
            "",
            "/",
            "chatter",
            "/a//b",
            "/a/",
            "/a**",
            "/***",
            "/[a]",
            "/a?",
            "/a b",
            &format!("/{}", "a".repeat(MAX_PATTERN)),
        ] {
            assert!(Pattern::parse(text).is_err(), "{text:?}");
        }
    }

    /// Against the definition, for all patterns of up to four segments and all names of up to four.
    #[test]
    fn matching_is_as_defined() {
        fn defined(pattern: &[&str], name: &[&str]) -> bool {
            match pattern {
                [] => name.is_empty(),
                ["**", rest @ ..] => (0..=name.len()).any(|skipped| defined(rest, &name[skipped..])),
                ["*", rest @ ..] => !name.is_empty() && defined(rest, &name[1..]),
                [first, rest @ ..] => name.first() == Some(first) && defined(rest, &name[1..]),
            }
        }
        let all = |parts: &[&'static str]| {
            let mut all: Vec<Vec<&str>> = parts.iter().map(|part| vec![*part]).collect();
            for from in 0.. {
                let Some(begin) = all.get(from).filter(|begin| begin.len() < 4).cloned() else { break };
                all.extend(parts.iter().map(|part| [&begin[..], &[*part]].concat()));
            }
            all
        };
        let mut matched = 0;
        for pattern in all(&["a", "*", "**"]) {
            for name in all(&["a", "b"]) {
                let (text, topic) = (format!("/{}", pattern.join("/")), format!("/{}", name.join("/")));
                assert_eq!(matches(&text, &topic), defined(&pattern, &name), "{text} {topic}");
                matched += usize::from(matches(&text, &topic));
            }
        }
        assert!(matched > 100, "{matched}");
    }

    #[test]
    fn a_hostile_pattern_takes_no_longer_than_another() {
        let pattern = "/*a".to_owned() + &"*a".repeat(100);
        let topic = format!("/{}b", "a".repeat(200));
        assert!(!matches(&pattern, &topic));
    }
}
