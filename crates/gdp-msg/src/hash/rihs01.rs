//! Computes the type hash of ROS 2: version 1 of the ROS Interface Hashing Standard (REP-2011,
//! REP-2016). It is the SHA-256 of the JSON that `rosidl_generator_type_description` makes of a
//! type and all nested types.

use std::collections::BTreeMap;
use std::fmt::Write;

use sha2::{Digest, Sha256};

use crate::definition::{Base, Count, Definition, Scalar};
use crate::dialect::Dialect;
use crate::schema::Schema;

/// Returns `RIHS01_` and 64 hex digits. The hash of a service or an action is that of the type with
/// its name, which contains all its parts.
pub fn type_hash(schema: &Schema) -> String {
    let mut json = String::from(r#"{"type_description": "#);
    describe(&mut json, schema, schema.root());
    json.push_str(r#", "referenced_type_descriptions": ["#);
    let referenced: BTreeMap<_, _> =
        schema.definitions().skip(1).map(|inner| (inner.name.to_string(), inner)).collect();
    for (index, inner) in referenced.into_values().enumerate() {
        json.push_str(if index > 0 { ", " } else { "" });
        describe(&mut json, schema, inner);
    }
    json.push_str("]}");
    format!("RIHS01_{}", hex::encode(Sha256::digest(json)))
}

fn describe(json: &mut String, schema: &Schema, definition: &Definition) {
    let _ = write!(json, r#"{{"type_name": "{}", "fields": ["#, definition.name);
    if definition.fields.is_empty() {
        field(json, schema.dialect(), "structure_needs_at_least_one_member", &Base::Scalar(Scalar::UInt8), Count::One);
    }
    for (index, f) in definition.fields.iter().enumerate() {
        json.push_str(if index > 0 { ", " } else { "" });
        field(json, schema.dialect(), &f.name, &f.base, f.count);
    }
    json.push_str("]}");
}

fn field(json: &mut String, dialect: Dialect, name: &str, base: &Base, count: Count) {
    let (offset, capacity) = match count {
        Count::One => (0, 0),
        Count::Fixed(length) => (48, length),
        Count::Sequence(Some(bound)) => (96, bound),
        Count::Sequence(None) => (144, 0),
    };
    let (string_capacity, nested) = match base {
        Base::String(bound) | Base::WString(bound) => (bound.unwrap_or(0), String::new()),
        Base::Named(name) => (0, name.to_string()),
        Base::Time => (0, "builtin_interfaces/msg/Time".into()),
        Base::Duration => (0, "builtin_interfaces/msg/Duration".into()),
        Base::Scalar(_) => (0, String::new()),
    };
    let id = offset + type_id(dialect, base);
    let _ = write!(
        json,
        r#"{{"name": "{name}", "type": {{"type_id": {id}, "capacity": {capacity}, "string_capacity": {string_capacity}, "nested_type_name": "{nested}"}}}}"#
    );
}

/// Returns the type ID of `type_description_interfaces/msg/FieldType`.
fn type_id(dialect: Dialect, base: &Base) -> u32 {
    match base {
        Base::Named(_) | Base::Time | Base::Duration => 1,
        // `byte` is an IDL octet; `char` becomes an IDL uint8.
        Base::Scalar(Scalar::Byte) => 16,
        Base::Scalar(scalar) => match scalar.plain(dialect) {
            Scalar::Int8 => 2,
            Scalar::UInt8 | Scalar::Byte | Scalar::Char => 3,
            Scalar::Int16 => 4,
            Scalar::UInt16 => 5,
            Scalar::Int32 => 6,
            Scalar::UInt32 => 7,
            Scalar::Int64 => 8,
            Scalar::UInt64 => 9,
            Scalar::Float32 => 10,
            Scalar::Float64 => 11,
            Scalar::Bool => 15,
        },
        Base::String(None) => 17,
        Base::WString(None) => 18,
        Base::String(Some(_)) => 21,
        Base::WString(Some(_)) => 22,
    }
}
