//! The md5sum of ROS 1 types, as `genmsg` computes it.

use std::collections::HashMap;
use std::fmt::Write;

use crate::definition::{Base, Constant, Definition, Field, type_text};
use crate::name::TypeName;
use crate::schema::Schema;

/// Of a ROS 1 message: of its definition without comments, constants first, each message inside
/// replaced by its md5sum. As 32 hex digits.
pub fn md5sum(schema: &Schema) -> String {
    hex::encode(md5::compute(text(schema, schema.root(), &mut HashMap::new())).0)
}

/// Of a ROS 1 service: over its two halves.
pub fn service_md5sum(request: &Schema, response: &Schema) -> String {
    let of = |schema| text(schema, schema.root(), &mut HashMap::new());
    hex::encode(md5::compute(of(request) + &of(response)).0)
}

/// `done`: of types that were hashed already, so that each is hashed once.
fn text<'a>(schema: &'a Schema, definition: &'a Definition, done: &mut HashMap<&'a TypeName, String>) -> String {
    let mut all = String::new();
    for Constant { base, name, text } in &definition.constants {
        let _ = writeln!(all, "{} {name}={text}", type_text(base, crate::Count::One));
    }
    for Field { base, count, name, .. } in &definition.fields {
        let _ = match base {
            Base::Named(inner) => {
                if !done.contains_key(inner) {
                    let sum = md5::compute(text(schema, schema.get(inner), done));
                    done.insert(inner, hex::encode(sum.0));
                }
                // Without the brackets of an array.
                writeln!(all, "{} {name}", done[inner])
            }
            base => writeln!(all, "{} {name}", type_text(base, *count)),
        };
    }
    all.truncate(all.trim_end().len());
    all
}
