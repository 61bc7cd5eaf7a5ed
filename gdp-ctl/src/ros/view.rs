//! A message with its definition. JSON contains the values, and the definition states their order
//! and types.

use gdp_msg::{Base, Count, Dialect, Scalar, Schema};
use gdp_ros::fill::definition;
use serde_json::Value;

use crate::ros::item::Item;

/// A message, or a field of one.
#[derive(Clone, Copy)]
pub struct View<'a> {
    schema: &'a Schema,
    pub base: &'a Base,
    pub count: Count,
    pub value: &'a Value,
}

/// Limits of the printed output of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Maximum characters of a text, and elements of an array.
    pub length: usize,
    /// Print only the type of arrays.
    pub no_arrays: bool,
    /// Print only the length of texts.
    pub no_texts: bool,
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ViewError {
    #[error("there is no field `{field}` in {of}; it has {}", listed(there))]
    Field { field: String, of: String, there: Vec<String> },
    #[error("`{0}` is no message, so it has no field `{1}`")]
    NoMessage(&'static str, String),
    #[error("the values do not fit the definition")]
    Misfit,
}

fn listed(names: &[String]) -> String {
    if names.is_empty() { "none".into() } else { names.join(", ") }
}

/// Returns the fields of a message, including the two built-in messages of ROS 1.
fn members<'a>(schema: &'a Schema, base: &'a Base) -> Option<Vec<(&'a str, &'a Base, Count)>> {
    const UNSIGNED: Base = Base::Scalar(Scalar::UInt32);
    const SIGNED: Base = Base::Scalar(Scalar::Int32);
    match base {
        Base::Named(name) => {
            let fields = &definition(schema, name)?.fields;
            Some(fields.iter().map(|field| (&*field.name, &field.base, field.count)).collect())
        }
        Base::Time => Some(vec![("secs", &UNSIGNED, Count::One), ("nsecs", &UNSIGNED, Count::One)]),
        Base::Duration => Some(vec![("secs", &SIGNED, Count::One), ("nsecs", &SIGNED, Count::One)]),
        _ => None,
    }
}

impl<'a> View<'a> {
    /// Creates the view of a message. `root`: [`Base::Named`] with the schema's own name.
    pub fn of(schema: &'a Schema, root: &'a Base, value: &'a Value) -> Self {
        Self { schema, base: root, count: Count::One, value }
    }

    /// Returns the fields, if this is a message.
    pub fn fields(&self) -> Option<Vec<(&'a str, Self)>> {
        let members = members(self.schema, self.base).filter(|_| self.count == Count::One)?;
        let view =
            |(name, base, count)| Some((name, Self { schema: self.schema, base, count, value: self.value.get(name)? }));
        members.into_iter().map(view).collect()
    }

    /// Returns a nested field, such as `pose.position.x`.
    pub fn at(&self, path: &[String]) -> Result<Self, ViewError> {
        let mut view = *self;
        for field in path {
            let fields = view.fields().ok_or_else(|| ViewError::NoMessage(view.kind_name(), field.clone()))?;
            let found = fields.iter().find(|(name, _)| *name == &**field).map(|(_, view)| *view);
            let Some(found) = found else {
                let of = if let Base::Named(name) = view.base { name.to_string() } else { view.kind_name().into() };
                let there = fields.iter().map(|(name, _)| (*name).to_owned()).collect();
                return Err(ViewError::Field { field: field.clone(), of, there });
            };
            view = found;
        }
        Ok(view)
    }

    /// Returns whether this is a `byte` of ROS 2, which Python represents as text of one character.
    pub fn is_byte(&self) -> bool {
        self.schema.dialect() == Dialect::Ros2 && *self.base == Base::Scalar(Scalar::Byte)
    }

    pub fn is_message(&self) -> bool {
        self.count == Count::One && matches!(self.base, Base::Named(_) | Base::Time | Base::Duration)
    }

    /// Returns at most `most` of the first elements, and the total number of elements.
    pub fn elements(&self, most: usize) -> Result<(Vec<Value>, usize), ViewError> {
        if let Value::Array(values) = self.value {
            return Ok((values.iter().take(most).cloned().collect(), values.len()));
        }
        let text = self.value.as_str().ok_or(ViewError::Misfit)?;
        let padding = text.bytes().rev().take_while(|c| *c == b'=').count();
        let length = (text.len() / 4 * 3).checked_sub(padding).ok_or(ViewError::Misfit)?;
        let shown = length.min(most);
        let head = text.get(..shown.div_ceil(3) * 4).ok_or(ViewError::Misfit)?;
        let bytes = <base64ct::Base64 as base64ct::Encoding>::decode_vec(head).map_err(|_| ViewError::Misfit)?;
        Ok((bytes.iter().take(shown).map(|byte| Value::from(*byte)).collect(), length))
    }

    /// Returns a view of one element.
    pub fn element<'b>(&self, value: &'b Value) -> View<'b>
    where
        'a: 'b,
    {
        View { schema: self.schema, base: self.base, count: Count::One, value }
    }

    /// Converts the value for printing, as `rosidl_runtime_py` does.
    pub fn item(&self, limits: &Limits) -> Result<Item, ViewError> {
        match self.count {
            Count::One => self.one(limits),
            _ if limits.no_arrays => Ok(Item::Text(self.array_text()?)),
            _ => self.many(limits),
        }
    }

    fn many(&self, limits: &Limits) -> Result<Item, ViewError> {
        let (values, length) = self.elements(limits.length)?;
        let mut items = values.iter().map(|value| self.element(value).one(limits)).collect::<Result<Vec<_>, _>>()?;
        if length > values.len() {
            items.push(Item::Text("...".into()));
        }
        Ok(Item::List(items))
    }

    fn one(&self, limits: &Limits) -> Result<Item, ViewError> {
        if let Some(fields) = self.fields() {
            let shown = |(name, view): (&str, View<'_>)| Ok((name.to_owned(), view.item(limits)?));
            return Ok(Item::Map(fields.into_iter().map(shown).collect::<Result<_, _>>()?));
        }
        match self.base {
            Base::Scalar(Scalar::Bool) => self.value.as_bool().map(Item::Bool).ok_or(ViewError::Misfit),
            Base::Scalar(Scalar::Float32 | Scalar::Float64) => Ok(Item::Float(self.float()?)),
            Base::Scalar(_) if self.is_byte() => {
                let byte = self.integer().and_then(|value| u8::try_from(value).ok()).ok_or(ViewError::Misfit)?;
                Ok(Item::Text(char::from(byte).into()))
            }
            Base::Scalar(_) => self.integer().map(Item::Integer).ok_or(ViewError::Misfit),
            _ => {
                let text = self.value.as_str().ok_or(ViewError::Misfit)?;
                Ok(Item::Text(shortened(text, limits)))
            }
        }
    }

    /// Returns the integer. JSON represents integers as text if they exceed the exact range of JSON
    /// readers.
    pub fn integer(&self) -> Option<i128> {
        let number = self.value.as_i64().map(i128::from).or_else(|| self.value.as_u64().map(i128::from));
        number.or_else(|| self.value.as_str()?.parse().ok())
    }

    /// Returns the float. Python has no single precision: it prints single-precision values
    /// converted to double.
    pub fn float(&self) -> Result<f64, ViewError> {
        let value = match self.value {
            Value::String(text) => match &**text {
                "NaN" => f64::NAN,
                "Infinity" => f64::INFINITY,
                "-Infinity" => f64::NEG_INFINITY,
                _ => return Err(ViewError::Misfit),
            },
            number => number.as_f64().ok_or(ViewError::Misfit)?,
        };
        Ok(if *self.base == Base::Scalar(Scalar::Float32) { f64::from(value as f32) } else { value })
    }

    /// Returns a description of an array without its elements.
    fn array_text(&self) -> Result<String, ViewError> {
        let named = match self.base {
            Base::Named(name) => name.to_string(),
            _ => self.kind_name().to_owned(),
        };
        let length = || self.elements(0).map(|(_, length)| length);
        Ok(match self.count {
            Count::Fixed(length) => format!("<array type: {named}[{length}]>"),
            Count::Sequence(Some(most)) => format!("<sequence type: {named}[{most}], length: {}>", length()?),
            _ => format!("<sequence type: {named}, length: {}>", length()?),
        })
    }

    /// Returns the IDL name of a type that is not a message.
    fn kind_name(&self) -> &'static str {
        match self.base {
            Base::Scalar(Scalar::Bool) => "boolean",
            Base::Scalar(Scalar::Byte) => "octet",
            Base::Scalar(Scalar::Char) => "uint8",
            Base::Scalar(Scalar::Float32) => "float",
            Base::Scalar(Scalar::Float64) => "double",
            Base::Scalar(scalar) => scalar.name(),
            Base::String(_) => "string",
            Base::WString(_) => "wstring",
            Base::Time => "time",
            Base::Duration => "duration",
            Base::Named(_) => "message",
        }
    }
}

fn shortened(text: &str, limits: &Limits) -> String {
    if limits.no_texts {
        return format!("<string length: <{}>>", text.chars().count());
    }
    match text.char_indices().nth(limits.length) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}
