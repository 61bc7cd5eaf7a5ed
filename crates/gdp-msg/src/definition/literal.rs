//! Checks the literals of constants and default values. Definitions store them as text, since
//! hashes and tools need the text.

use super::{Base, Count, Scalar};
use crate::dialect::Dialect;

/// Returns whether `text` is a value of the type, as this dialect's compilers read it.
pub(super) fn is_value(dialect: Dialect, base: &Base, count: Count, text: &str) -> bool {
    let (most, exact) = match count {
        Count::One => return is_single(dialect, base, text),
        Count::Fixed(length) => (length, true),
        Count::Sequence(bound) => (bound.unwrap_or(u32::MAX), false),
    };
    let Some(inside) = text.strip_prefix('[').and_then(|text| text.strip_suffix(']')) else { return false };
    let mut length = 0;
    let mut rest = inside.trim();
    while !rest.is_empty() {
        let (element, after) = first_element(rest);
        if !is_single(dialect, base, element.trim()) {
            return false;
        }
        length += 1;
        rest = after.trim_start();
    }
    if exact { length == most } else { length <= most }
}

/// Splits a text at the first comma outside quotes.
fn first_element(text: &str) -> (&str, &str) {
    let mut quote = None;
    let mut escaped = false;
    for (at, c) in text.char_indices() {
        match quote {
            _ if escaped => escaped = false,
            Some(_) if c == '\\' => escaped = true,
            Some(q) if q == c => quote = None,
            None if c == '"' || c == '\'' => quote = Some(c),
            None if c == ',' => return (&text[..at], &text[at + 1..]),
            _ => {}
        }
    }
    (text, "")
}

fn is_single(dialect: Dialect, base: &Base, text: &str) -> bool {
    match base {
        Base::Scalar(scalar) => is_scalar(scalar.plain(dialect), text),
        Base::String(bound) => bound.is_none_or(|bound| unquoted(text).len() <= bound as usize),
        Base::WString(bound) => bound.is_none_or(|bound| unquoted(text).encode_utf16().count() <= bound as usize),
        Base::Time | Base::Duration | Base::Named(_) => false,
    }
}

fn is_scalar(scalar: Scalar, text: &str) -> bool {
    let (low, high) = match scalar {
        Scalar::Bool => return ["true", "false", "1", "0"].iter().any(|word| word.eq_ignore_ascii_case(text)),
        Scalar::Float32 | Scalar::Float64 => return text.parse::<f64>().is_ok(),
        Scalar::Int8 => (i8::MIN.into(), i8::MAX.into()),
        Scalar::UInt8 | Scalar::Byte | Scalar::Char => (0, u8::MAX.into()),
        Scalar::Int16 => (i16::MIN.into(), i16::MAX.into()),
        Scalar::UInt16 => (0, u16::MAX.into()),
        Scalar::Int32 => (i32::MIN.into(), i32::MAX.into()),
        Scalar::UInt32 => (0, u32::MAX.into()),
        Scalar::Int64 => (i64::MIN.into(), i64::MAX.into()),
        Scalar::UInt64 => (0, u64::MAX.into()),
    };
    integer(text).is_some_and(|value| (low..=high).contains(&value))
}

/// Parses an integer: decimal, `0x…`, `0o…` or `0b…`, with an optional sign.
fn integer(text: &str) -> Option<i128> {
    let (sign, digits) = match text.strip_prefix('-') {
        Some(digits) => (-1, digits),
        None => (1, text.strip_prefix('+').unwrap_or(text)),
    };
    let lower = digits.to_ascii_lowercase();
    let radix = |prefix: &str| lower.strip_prefix(prefix);
    let (radix, digits) = match (radix("0x"), radix("0o"), radix("0b")) {
        (Some(digits), ..) => (16, digits),
        (_, Some(digits), _) => (8, digits),
        (.., Some(digits)) => (2, digits),
        _ => (10, &*lower),
    };
    let magnitude = digits.bytes().all(|byte| byte.is_ascii_alphanumeric()).then(|| u64::from_str_radix(digits, radix));
    Some(sign * i128::from(magnitude?.ok()?))
}

/// Removes the quotes of either kind around a text.
fn unquoted(text: &str) -> &str {
    let inside = |quote: char| text.strip_prefix(quote).and_then(|text| text.strip_suffix(quote));
    inside('"').or_else(|| inside('\'')).unwrap_or(text)
}
