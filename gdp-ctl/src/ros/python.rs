//! Values in Python notation, as `ros2 topic pub`, `ros2 service call` and `ros2 topic echo --raw`
//! print them.

use gdp_msg::{Base, Count, Scalar};

use super::view::{View, ViewError};

pub use gdp_ros::fill::float_text as float;

/// Returns `repr` of a string.
pub fn string(value: &str) -> String {
    let quote = if value.contains('\'') && !value.contains('"') { '"' } else { '\'' };
    let mut out = String::from(quote);
    for c in value.chars() {
        match c {
            '\n' => out += "\\n",
            '\r' => out += "\\r",
            '\t' => out += "\\t",
            '\\' => out += "\\\\",
            c if c == quote => out.extend(['\\', c]),
            c if c.is_control() => out += &format!("\\x{:02x}", c as u32),
            c => out.push(c),
        }
    }
    out.push(quote);
    out
}

/// Returns `repr` of bytes.
pub fn bytes(value: &[u8]) -> String {
    let quote = if value.contains(&b'\'') && !value.contains(&b'"') { '"' } else { '\'' };
    let mut out = format!("b{quote}");
    for byte in value {
        match byte {
            b'\n' => out += "\\n",
            b'\r' => out += "\\r",
            b'\t' => out += "\\t",
            b'\\' => out += "\\\\",
            byte if char::from(*byte) == quote => out.extend(['\\', quote]),
            b' '..=b'~' => out.push(char::from(*byte)),
            byte => out += &format!("\\x{byte:02x}"),
        }
    }
    out.push(quote);
    out
}

/// Returns `repr` of a message or a value in it.
pub fn value(view: &View<'_>) -> Result<String, ViewError> {
    if view.count != Count::One {
        let (values, _) = view.elements(usize::MAX)?;
        let items = values.iter().map(|element| value(&view.element(element))).collect::<Result<Vec<_>, _>>()?;
        let list = format!("[{}]", items.join(", "));
        // Python has numpy arrays for fixed arrays of numbers.
        let is_numpy =
            matches!((view.count, view.base), (Count::Fixed(_), Base::Scalar(scalar)) if *scalar != Scalar::Bool);
        return Ok(if is_numpy && !view.is_byte() { format!("array({list})") } else { list });
    }
    if let Some(fields) = view.fields() {
        let of = match view.base {
            Base::Named(name) => format!("{}.{}.{}", name.package(), name.kind().folder(), name.name()),
            Base::Duration => "genpy.Duration".into(),
            _ => "genpy.Time".into(),
        };
        let shown = |(name, field): (&str, View<'_>)| Ok(format!("{name}={}", value(&field)?));
        let fields = fields.into_iter().map(shown).collect::<Result<Vec<_>, ViewError>>()?;
        return Ok(format!("{of}({})", fields.join(", ")));
    }
    match view.base {
        Base::Scalar(Scalar::Bool) => {
            let value = view.value.as_bool().ok_or(ViewError::Misfit)?;
            Ok(if value { "True".into() } else { "False".into() })
        }
        Base::Scalar(Scalar::Float32 | Scalar::Float64) => Ok(float(view.float()?)),
        Base::Scalar(_) if view.is_byte() => {
            let byte = view.integer().and_then(|value| u8::try_from(value).ok()).ok_or(ViewError::Misfit)?;
            Ok(bytes(&[byte]))
        }
        Base::Scalar(_) => view.integer().map(|value| value.to_string()).ok_or(ViewError::Misfit),
        _ => Ok(string(view.value.as_str().ok_or(ViewError::Misfit)?)),
    }
}

#[cfg(test)]
#[path = "../../tests/unit/ros/python.rs"]
mod tests;
