//! Prints definitions as text without comments; [`super::parse`] reads the same definition from it.

use std::fmt::{self, Write};

use super::{Base, Constant, Count, Definition, Field};
use crate::name::InterfaceKind;

/// The line between two definitions, as `rosmsg` and `rosbag` write it.
const SEPARATOR: &str = "================================================================================";

/// Prints the first definition, then the others, each after a line with its name.
pub(crate) fn print_all<'a>(definitions: impl IntoIterator<Item = &'a Definition>) -> String {
    let mut text = String::new();
    for (index, definition) in definitions.into_iter().enumerate() {
        if index > 0 {
            let name = match definition.name.kind() {
                InterfaceKind::Message => format!("{}/{}", definition.name.package(), definition.name.name()),
                InterfaceKind::Service | InterfaceKind::Action => definition.name.to_string(),
            };
            let _ = write!(text, "{SEPARATOR}\nMSG: {name}\n");
        }
        let _ = write!(text, "{}", Printed(definition));
    }
    text
}

struct Printed<'a>(&'a Definition);

impl fmt::Display for Printed<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for Constant { base, name, text } in &self.0.constants {
            writeln!(f, "{} {name}={text}", type_text(base, Count::One))?;
        }
        for Field { base, count, name, default } in &self.0.fields {
            write!(f, "{} {name}", type_text(base, *count))?;
            default.iter().try_for_each(|default| write!(f, " {default}"))?;
            writeln!(f)?;
        }
        Ok(())
    }
}

/// Returns a type as in a definition, with the package of a named type.
pub(crate) fn type_text(base: &Base, count: Count) -> String {
    let mut text = match base {
        Base::Scalar(scalar) => scalar.name().to_owned(),
        Base::String(bound) => bounded("string", *bound),
        Base::WString(bound) => bounded("wstring", *bound),
        Base::Time => "time".to_owned(),
        Base::Duration => "duration".to_owned(),
        Base::Named(name) if name.kind() == InterfaceKind::Message => format!("{}/{}", name.package(), name.name()),
        Base::Named(name) => name.to_string(),
    };
    let _ = match count {
        Count::One => Ok(()),
        Count::Fixed(length) => write!(text, "[{length}]"),
        Count::Sequence(None) => write!(text, "[]"),
        Count::Sequence(Some(bound)) => write!(text, "[<={bound}]"),
    };
    text
}

fn bounded(name: &str, bound: Option<u32>) -> String {
    bound.map_or(name.to_owned(), |bound| format!("{name}<={bound}"))
}
