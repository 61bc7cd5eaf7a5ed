//! A user's input for a message, in YAML, which includes JSON. The values are parsed before their
//! types are known.

use std::fmt;

use serde::de::{self, Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};
use serde_saphyr::NonFiniteFloatPolicy;

#[derive(Clone, Debug, PartialEq)]
pub enum UserInput {
    Nothing,
    Bool(bool),
    Integer(i128),
    Float(f64),
    Text(String),
    List(Vec<UserInput>),
    /// Entries in the order of the input; each name occurs once.
    Map(Vec<(String, UserInput)>),
}

#[derive(Debug, thiserror::Error)]
#[error("no YAML: {0}")]
pub struct UserInputError(String);

impl UserInput {
    pub fn parse(text: &str) -> Result<Self, UserInputError> {
        if text.trim().is_empty() {
            return Ok(Self::Nothing);
        }
        let options = serde_saphyr::options! {
            with_snippet: false,
            non_finite_float_policy: NonFiniteFloatPolicy::PassThrough,
        };
        serde_saphyr::from_str_with_options(text, options).map_err(|error| UserInputError(error.to_string()))
    }

    /// Returns a description for error messages.
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

impl<'de> Deserialize<'de> for UserInput {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(UserInputVisitor)
    }
}

struct UserInputVisitor;

impl<'de> Visitor<'de> for UserInputVisitor {
    type Value = UserInput;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a value")
    }

    fn visit_bool<E>(self, value: bool) -> Result<UserInput, E> {
        Ok(UserInput::Bool(value))
    }

    fn visit_i64<E>(self, value: i64) -> Result<UserInput, E> {
        Ok(UserInput::Integer(value.into()))
    }

    fn visit_u64<E>(self, value: u64) -> Result<UserInput, E> {
        Ok(UserInput::Integer(value.into()))
    }

    fn visit_f64<E>(self, value: f64) -> Result<UserInput, E> {
        Ok(UserInput::Float(value))
    }

    fn visit_str<E>(self, value: &str) -> Result<UserInput, E> {
        Ok(UserInput::Text(value.to_owned()))
    }

    fn visit_unit<E>(self) -> Result<UserInput, E> {
        Ok(UserInput::Nothing)
    }

    fn visit_none<E>(self) -> Result<UserInput, E> {
        Ok(UserInput::Nothing)
    }

    fn visit_some<D: Deserializer<'de>>(self, deserializer: D) -> Result<UserInput, D::Error> {
        UserInput::deserialize(deserializer)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut access: A) -> Result<UserInput, A::Error> {
        let mut list = Vec::new();
        while let Some(value) = access.next_element()? {
            list.push(value);
        }
        Ok(UserInput::List(list))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut access: A) -> Result<UserInput, A::Error> {
        let mut map: Vec<(String, UserInput)> = Vec::new();
        while let Some((name, value)) = access.next_entry::<String, _>()? {
            if map.iter().any(|(other, _)| *other == name) {
                return Err(de::Error::custom(format_args!("`{name}` is given twice")));
            }
            map.push((name, value));
        }
        Ok(UserInput::Map(map))
    }
}

#[cfg(test)]
#[path = "../tests/unit/user_input.rs"]
mod tests;
