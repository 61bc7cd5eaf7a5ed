//! Unit tests of `config::schema`.

use std::path::Path;

use serde_json::Value;

use super::*;

#[test]
fn the_published_schema_is_this_one() {
    let published = include_str!("../../../../docs/gdp-proxy.schema.json");
    let schema: Value = schema().into();
    assert!(
        serde_json::from_str::<Value>(published).unwrap() == schema,
        "write it anew: gdp-proxy --schema > docs/gdp-proxy.schema.json"
    );
}

#[test]
fn the_examples_are_good_and_all_their_keys_are_in_the_schema() {
    let schema: Value = schema().into();
    let unknown = |text: &str| unknown_keys(&serde_saphyr::from_str(text).unwrap(), &schema, &schema);
    let expose = include_str!("../../../example-expose.yaml");
    for example in [include_str!("../../../example.yaml"), expose] {
        Config::parse(example, Path::new("example.yaml")).unwrap();
        assert_eq!(unknown(example), [""; 0]);
    }
    assert_eq!(unknown(&expose.replace("max_hz", "max_hertz")), ["max_hertz"]);
}

/// Keys of mappings that no alternative of the schema has.
fn unknown_keys(value: &Value, schema: &Value, root: &Value) -> Vec<String> {
    if let Some(path) = schema.get("$ref").and_then(Value::as_str) {
        return unknown_keys(value, root.pointer(path.trim_start_matches('#')).unwrap(), root);
    }
    if let Some(alternatives) = schema.get("anyOf").and_then(Value::as_array) {
        let tried = alternatives.iter().map(|alternative| unknown_keys(value, alternative, root));
        return tried.min_by_key(Vec::len).unwrap();
    }
    match value {
        Value::Array(items) => match schema.get("items") {
            Some(schema) => items.iter().flat_map(|item| unknown_keys(item, schema, root)).collect(),
            None => vec![value.to_string()],
        },
        Value::Object(entries) => {
            let of = |key: &String| {
                schema["properties"].get(key).or_else(|| schema.get("additionalProperties").filter(|of| of.is_object()))
            };
            let unknown = entries.iter().map(|(key, value)| match of(key) {
                Some(schema) => unknown_keys(value, schema, root),
                None => vec![key.clone()],
            });
            unknown.flatten().collect()
        }
        _ => vec![],
    }
}
