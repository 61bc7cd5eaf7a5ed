//! The published schema, `docs/gdp.cddl`. Tests beside the types validate what those encode.

use std::fs;
use std::path::PathBuf;
use std::sync::LazyLock;

use cddl::ast::{CDDL, Rule};
use cddl::validator::cbor::{CBORValidator, Error};
use cddl::validator::cbor_value::decode_cbor;

/// Parsing takes longer than many validations.
static SCHEMA: LazyLock<CDDL<'static>> = LazyLock::new(|| {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../docs/gdp.cddl");
    let text = fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    cddl::cddl_from_str(text.leak(), true).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
});

/// Validates bytes against the rule of this name.
pub fn check(rule: &str, bytes: &[u8]) -> Result<(), String> {
    let mut schema = SCHEMA.clone();
    // The first rule of a schema is its root.
    let is_wanted = |of: &Rule<'_>| matches!(of, Rule::Type { rule: of, .. } if of.name.ident == rule);
    let at = schema.rules.iter().position(is_wanted).unwrap_or_else(|| panic!("docs/gdp.cddl has no rule {rule}"));
    schema.rules.swap(0, at);
    let value = decode_cbor(bytes).map_err(|error| error.to_string())?;
    let result: Result<(), Error<std::io::Error>> =
        cddl::validator::Validator::validate(&mut CBORValidator::new(&schema, value, None));
    result.map_err(|error| error.to_string())
}
