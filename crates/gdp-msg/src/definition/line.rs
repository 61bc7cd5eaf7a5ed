//! Parses one line of a `.msg` text: a field, a constant, or nothing.
//!
//! The rules are those of the dialect's compiler: `genmsg` (ROS 1) or `rosidl_adapter` (ROS 2).
//! They differ in the start of a comment and in the meaning of a bare `Header`.

use std::collections::HashSet;

use super::literal;
use super::{
    Base, Constant, Count, Definition, DefinitionError, Field, MAX_ARRAY, MAX_FIELDS, MAX_TEXT, Problem, Scalar,
};
use crate::dialect::Dialect;
use crate::name::{TypeName, excerpt, is_identifier};

/// The member that ROS 2's compilers insert into an empty message. It is not a field.
pub(super) const PLACEHOLDER: &str = "structure_needs_at_least_one_member";

/// Parses the definition of one message.
///
/// # Errors
/// If a line is invalid. The error names the line, counted from `first_line`, and suggests a
/// correction.
pub(crate) fn parse(
    dialect: Dialect,
    name: &TypeName,
    text: &str,
    first_line: usize,
) -> Result<Definition, DefinitionError> {
    if text.len() > MAX_TEXT {
        return Err(DefinitionError::new(name, 0, Problem::TooLong));
    }
    let mut definition = Definition { name: name.clone(), constants: Vec::new(), fields: Vec::new() };
    // A constant and a field may share a name: `int32 x` and `int32 x=1` are in use.
    let mut names = HashSet::new();
    for (number, line) in text.lines().enumerate() {
        let refused = |problem| DefinitionError::new(name, first_line + number, problem);
        let Some(element) = element(dialect, name, line).map_err(refused)? else { continue };
        if definition.constants.len() + definition.fields.len() >= MAX_FIELDS {
            return Err(refused(Problem::TooMany));
        }
        let (is_field, element_name) = match &element {
            Element::Constant(constant) => (false, &constant.name),
            Element::Field(field) => (true, &field.name),
        };
        if !names.insert((is_field, element_name.clone())) {
            return Err(refused(Problem::Twice(element_name.to_string())));
        }
        match element {
            Element::Constant(constant) => definition.constants.push(constant),
            Element::Field(field) => definition.fields.push(field),
        }
    }
    if let [only] = &definition.fields[..]
        && &*only.name == PLACEHOLDER
    {
        definition.fields.clear();
    }
    Ok(definition)
}

enum Element {
    Constant(Constant),
    Field(Field),
}

fn element(dialect: Dialect, context: &TypeName, line: &str) -> Result<Option<Element>, Problem> {
    let code = line.split('#').next().unwrap_or_default().trim();
    if code.is_empty() {
        return Ok(None);
    }
    let Some((type_text, rest)) = code.split_once([' ', '\t']) else {
        return Err(Problem::Incomplete(excerpt(code)));
    };
    let rest = rest.trim_start();
    if let Some((name, value)) = rest.split_once('=') {
        let name = name.trim_end();
        // In ROS 1, a string constant is the rest of the line, including what looks like a comment.
        let value = match line.split_once('=') {
            Some((_, all)) if dialect == Dialect::Ros1 && type_text == "string" => all,
            _ => value,
        };
        let text = value.trim();
        let base = base(dialect, context, type_text)?;
        let is_value = literal::is_value(dialect, &base, Count::One, text);
        let constant = Constant { base, name: identifier(name)?, text: text.into() };
        return match constant.base {
            Base::Time | Base::Duration | Base::Named(_) => Err(Problem::Type(excerpt(type_text), dialect)),
            _ if !is_value => Err(Problem::Value(excerpt(type_text), excerpt(text))),
            _ => Ok(Some(Element::Constant(constant))),
        };
    }
    let (name, default) = match rest.split_once([' ', '\t']) {
        Some((name, default)) => (name, Some(default.trim())),
        None => (rest, None),
    };
    let (base_text, count) = count(dialect, type_text)?;
    let base = base(dialect, context, base_text)?;
    match default {
        Some(default) if dialect == Dialect::Ros1 => return Err(Problem::Default(excerpt(default))),
        Some(default) if !literal::is_value(dialect, &base, count, default) => {
            return Err(Problem::Value(excerpt(type_text), excerpt(default)));
        }
        _ => {}
    }
    let name = identifier(name)?;
    Ok(Some(Element::Field(Field { base, count, name, default: default.map(Into::into) })))
}

/// Splits `[…]` off a type.
fn count(dialect: Dialect, text: &str) -> Result<(&str, Count), Problem> {
    let Some((base, inside)) = text.strip_suffix(']').and_then(|text| text.rsplit_once('[')) else {
        return Ok((text, Count::One));
    };
    if inside.is_empty() {
        return Ok((base, Count::Sequence(None)));
    }
    match inside.strip_prefix("<=") {
        Some(bound) if dialect == Dialect::Ros2 => Ok((base, Count::Sequence(Some(length(bound)?)))),
        Some(_) => Err(Problem::Type(excerpt(text), dialect)),
        None => Ok((base, Count::Fixed(length(inside)?))),
    }
}

fn length(text: &str) -> Result<u32, Problem> {
    let refused = || Problem::Length(excerpt(text));
    let digits = text.bytes().all(|byte| byte.is_ascii_digit());
    let length = text.parse().ok().filter(|length| digits && (1..=MAX_ARRAY).contains(length));
    length.ok_or_else(refused)
}

fn base(dialect: Dialect, context: &TypeName, text: &str) -> Result<Base, Problem> {
    if let Some(scalar) = Scalar::from_name(text) {
        return Ok(Base::Scalar(scalar));
    }
    let ros2 = dialect == Dialect::Ros2;
    match text {
        "string" => return Ok(Base::String(None)),
        "wstring" if ros2 => return Ok(Base::WString(None)),
        "time" | "duration" if ros2 => {
            let name = if text == "time" { "Time" } else { "Duration" };
            return Ok(Base::Named(TypeName::message("builtin_interfaces", name)));
        }
        "time" => return Ok(Base::Time),
        "duration" => return Ok(Base::Duration),
        "Header" if !ros2 => return Ok(Base::Named(TypeName::message("std_msgs", "Header"))),
        _ => {}
    }
    match text.split_once("<=") {
        Some(("string", bound)) if ros2 => return Ok(Base::String(Some(length(bound)?))),
        Some(("wstring", bound)) if ros2 => return Ok(Base::WString(Some(length(bound)?))),
        _ => {}
    }
    if is_identifier(text) {
        return Ok(Base::Named(TypeName::message(context.package(), text)));
    }
    let named = TypeName::parse(text).ok().filter(|_| !text.contains(':'));
    named.map(Base::Named).ok_or_else(|| Problem::Type(excerpt(text), dialect))
}

fn identifier(name: &str) -> Result<Box<str>, Problem> {
    if is_identifier(name) { Ok(name.into()) } else { Err(Problem::Name(excerpt(name))) }
}
