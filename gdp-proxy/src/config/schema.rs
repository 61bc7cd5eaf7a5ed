//! The JSON Schema of the configuration file, for editors. The parser checks what a schema cannot
//! express.

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema, schema_for};

use super::automatic::{Role, RuleSaid};
use super::{Config, Pattern};

/// Returns the schema that `gdp-proxy --schema` prints.
pub fn schema() -> Schema {
    schema_for!(Config)
}

pub(super) fn rules(generator: &mut SchemaGenerator) -> Schema {
    list_of::<Pattern, RuleSaid>(generator)
}

pub(super) fn readers(generator: &mut SchemaGenerator) -> Schema {
    list_of::<String, Role>(generator)
}

/// The values of all builds. One without `aws-lc` refuses that value.
pub(super) fn crypto(_: &mut SchemaGenerator) -> Schema {
    json_schema!({"enum": ["aws-lc", "rustcrypto"]})
}

fn list_of<A: JsonSchema, B: JsonSchema>(generator: &mut SchemaGenerator) -> Schema {
    let either = [generator.subschema_for::<A>(), generator.subschema_for::<B>()];
    json_schema!({"type": "array", "items": {"anyOf": either}})
}

#[cfg(test)]
#[path = "../../tests/unit/config/schema.rs"]
mod tests;
