//! YAML as `ros2 topic echo` prints it, which is as PyYAML does: blocks, Unicode as it is, lines of
//! any length.

mod scalar;

use super::python;
use crate::ros::item::Item;
use scalar::text;

/// A document, without a line that ends it.
pub fn document(item: &Item) -> String {
    let mut out = String::new();
    match item {
        Item::Map(members) if !members.is_empty() => map(&mut out, members, 0, false),
        Item::List(items) if !items.is_empty() => list(&mut out, items, 0),
        other => {
            out += &inline(other, 2);
            out.push('\n');
        }
    }
    out
}

/// `is_begun`: the first member goes on behind a dash.
fn map(out: &mut String, members: &[(String, Item)], indent: usize, mut is_begun: bool) {
    for (name, item) in members {
        if !std::mem::take(&mut is_begun) {
            out.extend(std::iter::repeat_n(' ', indent));
        }
        *out += &text(name, indent + 2);
        out.push(':');
        match item {
            Item::Map(inner) if !inner.is_empty() => {
                out.push('\n');
                map(out, inner, indent + 2, false);
            }
            Item::List(items) if !items.is_empty() => {
                out.push('\n');
                list(out, items, indent);
            }
            other => {
                out.push(' ');
                *out += &inline(other, indent + 2);
                out.push('\n');
            }
        }
    }
}

/// ROS has no lists in lists.
fn list(out: &mut String, items: &[Item], indent: usize) {
    for item in items {
        out.extend(std::iter::repeat_n(' ', indent));
        *out += "- ";
        match item {
            Item::Map(members) if !members.is_empty() => map(out, members, indent + 2, true),
            other => {
                *out += &inline(other, indent + 2);
                out.push('\n');
            }
        }
    }
}

/// What takes one line, but for text with line breaks. `indent`: of its further lines.
fn inline(item: &Item, indent: usize) -> String {
    match item {
        Item::Bool(value) => value.to_string(),
        Item::Integer(value) => value.to_string(),
        Item::Float(value) => float(*value),
        Item::Text(value) => text(value, indent),
        Item::Map(_) => "{}".into(),
        Item::List(items) => {
            let items = items.iter().map(|item| inline(item, indent));
            format!("[{}]", items.collect::<Vec<_>>().join(", "))
        }
    }
}

/// Of a float's text, YAML 1.1 demands a point.
fn float(value: f64) -> String {
    match value {
        _ if value.is_nan() => ".nan".into(),
        f64::INFINITY => ".inf".into(),
        f64::NEG_INFINITY => "-.inf".into(),
        _ => {
            let text = python::float(value);
            if text.contains('.') { text } else { text.replacen('e', ".0e", 1) }
        }
    }
}
