//! Computes the md5sum of ROS 1 types as `genmsg` does.

use std::collections::HashMap;
use std::fmt::Write;

use crate::definition::{Base, Constant, Definition, Field, type_text};
use crate::name::TypeName;
use crate::schema::Schema;

/// Returns the md5sum of a ROS 1 message as 32 hex digits. It covers the definition without
/// comments, constants first, with each nested message replaced by its md5sum.
pub fn md5sum(schema: &Schema) -> String {
    hex::encode(md5::compute(text(schema, schema.root(), &mut HashMap::new())).0)
}

/// Returns the md5sum of a ROS 1 service, which covers request and response.
pub fn service_md5sum(request: &Schema, response: &Schema) -> String {
    let of = |schema| text(schema, schema.root(), &mut HashMap::new());
    hex::encode(md5::compute(of(request) + &of(response)).0)
}

/// Returns the text to hash. `done` caches the md5sums of nested types.
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
                // `genmsg` omits the brackets of an array here.
                writeln!(all, "{} {name}", done[inner])
            }
            base => writeln!(all, "{} {name}", type_text(base, *count)),
        };
    }
    all.truncate(all.trim_end().len());
    all
}
