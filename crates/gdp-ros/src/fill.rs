//! Completes a user's input to a whole message. Omitted fields get the definition's default, or
//! else zero or empty values, as in ROS 2. The result is JSON, which `gdp-msg` then checks against
//! the definition and encodes.

use gdp_msg::{Base, Count, Definition, Dialect, Field, Scalar, Schema, TypeName};
use serde_json::{Map, Value};

use crate::user_input::UserInput;

/// Maximum number of zero elements added to fixed arrays of one message.
const MAX_FILLED: usize = 1 << 20;

/// Reasons why the input is not a valid message.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FillError {
    #[error("{of} has no field `{field}`; its fields are: {}", there.join(", "))]
    Unknown { field: String, of: TypeName, there: Vec<String> },
    #[error("`{path}`: {expected} is expected, and {got} is given")]
    Other { path: String, expected: String, got: &'static str },
    #[error("`{path}`: {length} elements, and {got} are given")]
    Length { path: String, length: u32, got: usize },
    #[error("`{path}`: give it, as it is too large to be filled with zeros")]
    TooLarge { path: String },
}

/// Returns the message for `input`. `now`: seconds and nanoseconds for times given as `now`, and
/// for headers given as `auto`.
pub fn fill(schema: &Schema, input: &UserInput, now: (u64, u32)) -> Result<Value, FillError> {
    Fill { schema, now, room: MAX_FILLED }.message("", schema.name(), input)
}

/// Returns the definition of a type in the schema.
pub fn definition<'a>(schema: &'a Schema, name: &TypeName) -> Option<&'a Definition> {
    schema.definitions().find(|definition| definition.name == *name)
}

/// Returns whether JSON represents arrays of this scalar as base64.
pub fn is_octet(scalar: Scalar) -> bool {
    matches!(scalar, Scalar::Byte | Scalar::Char | Scalar::UInt8)
}

struct Fill<'a> {
    schema: &'a Schema,
    now: (u64, u32),
    room: usize,
}

impl Fill<'_> {
    fn message(&mut self, path: &str, of: &TypeName, input: &UserInput) -> Result<Value, FillError> {
        let fields = definition(self.schema, of).map_or(&[][..], |definition| &definition.fields);
        let auto = UserInput::Map(vec![("stamp".into(), UserInput::Text("now".into()))]);
        let input = match input {
            UserInput::Nothing => &[][..],
            UserInput::Map(members) => members,
            UserInput::Text(text) if text == "auto" && is(of, "std_msgs", "Header") => match &auto {
                UserInput::Map(members) => members,
                _ => &[][..],
            },
            UserInput::Text(text) if text == "now" && is(of, "builtin_interfaces", "Time") => {
                return Ok(self.stamp(["sec", "nanosec"]));
            }
            other => return Err(unlike(path, format!("a mapping with fields of {of}"), other)),
        };
        if let Some((name, _)) = input.iter().find(|(name, _)| !fields.iter().any(|field| *field.name == **name)) {
            let there = fields.iter().map(|field| field.name.to_string()).collect();
            return Err(FillError::Unknown { field: inside(path, name), of: of.clone(), there });
        }
        let mut members = Map::new();
        for field in fields {
            let path = inside(path, &field.name);
            let value = match input.iter().find(|(name, _)| *field.name == **name) {
                Some((_, input)) => self.field(&path, field, input)?,
                None => self.default(&path, field)?,
            };
            members.insert(field.name.to_string(), value);
        }
        Ok(Value::Object(members))
    }

    /// Returns the default of a field. Default texts in the definition are YAML.
    fn default(&mut self, path: &str, field: &Field) -> Result<Value, FillError> {
        match field.default.as_ref().and_then(|text| UserInput::parse(text).ok()) {
            Some(input) => self.field(path, field, &input),
            None => self.field(path, field, &UserInput::Nothing),
        }
    }

    fn field(&mut self, path: &str, field: &Field, input: &UserInput) -> Result<Value, FillError> {
        if field.count == Count::One {
            return self.one(path, &field.base, input);
        }
        let octets = matches!(field.base, Base::Scalar(scalar) if is_octet(scalar));
        let items = match (input, field.count) {
            (UserInput::List(items), Count::Fixed(length)) if items.len() != length as usize => {
                return Err(FillError::Length { path: path.into(), length, got: items.len() });
            }
            (UserInput::List(items), _) => items,
            (UserInput::Nothing, Count::Fixed(length)) => {
                self.room =
                    self.room.checked_sub(length as usize).ok_or_else(|| FillError::TooLarge { path: path.into() })?;
                let zeros = (0..length).map(|_| self.one(path, &field.base, &UserInput::Nothing));
                return zeros.collect::<Result<_, _>>().map(Value::Array);
            }
            (UserInput::Nothing, _) => &vec![],
            // Base64, as in JSON.
            (UserInput::Text(base64), _) if octets => return Ok(Value::String(base64.clone())),
            (other, _) => return Err(unlike(path, "a list".into(), other)),
        };
        let filled = items.iter().enumerate().map(|(i, item)| self.one(&format!("{path}[{i}]"), &field.base, item));
        filled.collect::<Result<_, _>>().map(Value::Array)
    }

    fn one(&mut self, path: &str, base: &Base, input: &UserInput) -> Result<Value, FillError> {
        match base {
            Base::Named(name) => self.message(path, name, input),
            Base::Time | Base::Duration => self.stamp_of_ros1(path, input),
            Base::String(_) | Base::WString(_) => match input {
                UserInput::Nothing => Ok("".into()),
                UserInput::Text(text) => Ok(text.clone().into()),
                // `data: 5` is also valid for a text, as in ROS 2.
                UserInput::Integer(value) => Ok(value.to_string().into()),
                UserInput::Float(value) => Ok(float_text(*value).into()),
                other => Err(unlike(path, "a text, in quotes".into(), other)),
            },
            Base::Scalar(scalar) => self.scalar(path, *scalar, input),
        }
    }

    fn scalar(&self, path: &str, scalar: Scalar, input: &UserInput) -> Result<Value, FillError> {
        let is_float = matches!(scalar, Scalar::Float32 | Scalar::Float64);
        match (scalar, input) {
            (Scalar::Bool, UserInput::Nothing) => Ok(false.into()),
            (Scalar::Bool, UserInput::Bool(value)) => Ok((*value).into()),
            (Scalar::Bool, other) => Err(unlike(path, "true or false".into(), other)),
            (_, UserInput::Nothing) => Ok(0.into()),
            (_, UserInput::Integer(value)) if is_float => Ok((*value as f64).into()),
            (_, UserInput::Integer(value)) => {
                let small = i64::try_from(*value).map(Value::from);
                // JSON represents larger integers as text. The encoder checks their range.
                Ok(small.unwrap_or_else(|_| value.to_string().into()))
            }
            (_, UserInput::Float(value)) if is_float => Ok(match *value {
                value if value.is_nan() => "NaN".into(),
                f64::INFINITY => "Infinity".into(),
                f64::NEG_INFINITY => "-Infinity".into(),
                value => value.into(),
            }),
            // A character, as `topic echo` prints it; otherwise a number as in JSON.
            (Scalar::Byte, UserInput::Text(text))
                if self.schema.dialect() == Dialect::Ros2 && text.chars().count() == 1 =>
            {
                let byte = text.chars().next().and_then(|c| u8::try_from(c).ok());
                byte.map(Value::from).ok_or_else(|| unlike(path, "a character of one byte".into(), input))
            }
            (Scalar::Int64 | Scalar::UInt64 | Scalar::Float32 | Scalar::Float64, UserInput::Text(text)) => {
                Ok(text.clone().into())
            }
            (_, other) => Err(unlike(path, format!("a number ({})", scalar.name()), other)),
        }
    }

    fn stamp_of_ros1(&mut self, path: &str, input: &UserInput) -> Result<Value, FillError> {
        let members = match input {
            UserInput::Text(text) if text == "now" => return Ok(self.stamp(["secs", "nsecs"])),
            UserInput::Nothing => &[][..],
            UserInput::Map(members) => members,
            other => return Err(unlike(path, "a mapping with secs and nsecs".into(), other)),
        };
        let mut stamp = Map::new();
        for name in ["secs", "nsecs"] {
            let input = members.iter().find(|(input, _)| input == name).map_or(&UserInput::Nothing, |(_, input)| input);
            stamp.insert(name.into(), self.scalar(&inside(path, name), Scalar::Int64, input)?);
        }
        match members.iter().find(|(name, _)| !stamp.contains_key(name)) {
            Some((name, input)) => Err(unlike(&inside(path, name), "secs or nsecs".into(), input)),
            None => Ok(Value::Object(stamp)),
        }
    }

    fn stamp(&self, [seconds, nanos]: [&str; 2]) -> Value {
        serde_json::json!({seconds: self.now.0, nanos: self.now.1})
    }
}

fn is(of: &TypeName, package: &str, name: &str) -> bool {
    of.package() == package && of.name() == name
}

fn inside(path: &str, field: &str) -> String {
    if path.is_empty() { field.to_owned() } else { format!("{path}.{field}") }
}

fn unlike(path: &str, expected: String, got: &UserInput) -> FillError {
    let path = if path.is_empty() { "the message" } else { path };
    FillError::Other { path: path.into(), expected, got: got.what() }
}

/// Returns a float as Python prints it: the shortest text that parses to the same number.
pub fn float_text(value: f64) -> String {
    if value.is_nan() {
        return "nan".into();
    }
    if value.is_infinite() {
        return if value > 0.0 { "inf".into() } else { "-inf".into() };
    }
    let exponent = match format!("{value:e}").split_once('e') {
        Some((_, exponent)) => exponent.parse::<i32>().unwrap_or_default(),
        None => 0,
    };
    if value == 0.0 || (-4..16).contains(&exponent) {
        return format!("{value:?}");
    }
    let text = format!("{value:e}");
    let (digits, _) = text.split_once('e').unwrap_or((&text, ""));
    let sign = if exponent < 0 { '-' } else { '+' };
    format!("{digits}e{sign}{:02}", exponent.abs())
}
