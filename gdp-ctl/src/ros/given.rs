//! What a user gives of a message, in YAML, of which JSON is a part: values, before it is known of which type they are to be.

use std::fmt;

use serde::de::{self, Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};
use serde_saphyr::NonFiniteFloatPolicy;

#[derive(Clone, Debug, PartialEq)]
pub enum Given {
    Nothing,
    Bool(bool),
    Integer(i128),
    Float(f64),
    Text(String),
    List(Vec<Given>),
    /// As it was written, each name once.
    Map(Vec<(String, Given)>),
}

#[derive(Debug, thiserror::Error)]
#[error("no YAML: {0}")]
pub struct GivenError(String);

impl Given {
    pub fn parse(text: &str) -> Result<Self, GivenError> {
        if text.trim().is_empty() {
            return Ok(Self::Nothing);
        }
        let options = serde_saphyr::options! {
            with_snippet: false,
            non_finite_float_policy: NonFiniteFloatPolicy::PassThrough,
        };
        serde_saphyr::from_str_with_options(text, options).map_err(|error| GivenError(error.to_string()))
    }

    /// For whoever reads why it does not fit.
    pub fn what(&self) -> &'static str {
        match self {
            Self::Nothing => "nothing",
            Self::Bool(_) => "a boolean",
            Self::Integer(_) => "an integer",
            Self::Float(_) => "a number",
            Self::Text(_) => "a text",
            Self::List(_) => "a list",
            Self::Map(_) => "a mapping",
        }
    }
}

impl<'de> Deserialize<'de> for Given {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(GivenVisitor)
    }
}

struct GivenVisitor;

impl<'de> Visitor<'de> for GivenVisitor {
    type Value = Given;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a value")
    }

    fn visit_bool<E>(self, value: bool) -> Result<Given, E> {
        Ok(Given::Bool(value))
    }

    fn visit_i64<E>(self, value: i64) -> Result<Given, E> {
        Ok(Given::Integer(value.into()))
    }

    fn visit_u64<E>(self, value: u64) -> Result<Given, E> {
        Ok(Given::Integer(value.into()))
    }

    fn visit_f64<E>(self, value: f64) -> Result<Given, E> {
        Ok(Given::Float(value))
    }

    fn visit_str<E>(self, value: &str) -> Result<Given, E> {
        Ok(Given::Text(value.to_owned()))
    }

    fn visit_unit<E>(self) -> Result<Given, E> {
        Ok(Given::Nothing)
    }

    fn visit_none<E>(self) -> Result<Given, E> {
        Ok(Given::Nothing)
    }

    fn visit_some<D: Deserializer<'de>>(self, deserializer: D) -> Result<Given, D::Error> {
        Given::deserialize(deserializer)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut access: A) -> Result<Given, A::Error> {
        let mut list = Vec::new();
        while let Some(value) = access.next_element()? {
            list.push(value);
        }
        Ok(Given::List(list))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut access: A) -> Result<Given, A::Error> {
        let mut map: Vec<(String, Given)> = Vec::new();
        while let Some((name, value)) = access.next_entry::<String, _>()? {
            if map.iter().any(|(other, _)| *other == name) {
                return Err(de::Error::custom(format_args!("`{name}` is given twice")));
            }
            map.push((name, value));
        }
        Ok(Given::Map(map))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn yaml_and_json_are_values() {
        let given = Given::parse("{a: 1, b: [true, 2.5, .inf], c: '7', d: {e: no text}, f: 0x10}").unwrap();
        let Given::Map(members) = given else { panic!("{given:?}") };
        assert_eq!(members[0], ("a".into(), Given::Integer(1)));
        let list = vec![Given::Bool(true), Given::Float(2.5), Given::Float(f64::INFINITY)];
        assert_eq!(members[1], ("b".into(), Given::List(list)));
        assert_eq!(members[2], ("c".into(), Given::Text("7".into())));
        assert_eq!(members[4], ("f".into(), Given::Integer(16)));
        assert_eq!(Given::parse(" ").unwrap(), Given::Nothing);
        assert!(Given::parse(r#"{"x": [1, -2], "y": "z"}"#).is_ok());
        assert_eq!(Given::parse("18446744073709551615").unwrap(), Given::Integer(u64::MAX.into()));
    }

    #[test]
    fn what_is_none_is_refused() {
        for text in ["{a: 1", "a: 1\na: 2", "[1, 2", "a: 1\n b: 2"] {
            assert!(Given::parse(text).is_err(), "{text}");
        }
        let deep = "[".repeat(100_000);
        assert!(Given::parse(&deep).is_err());
    }
}
