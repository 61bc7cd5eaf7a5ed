//! Unit tests of `config::schema`.

use std::path::Path;

use gdp_tests::book::{file_keys, reference};
use serde_json::Value;

use super::*;

#[test]
fn the_published_schema_is_this_one() {
    let text = serde_json::to_string_pretty(&schema()).unwrap() + "\n";
    reference::check("docs/gdp-proxy.schema.json", &text);
}

#[test]
fn the_reference_page_has_the_keys_of_this_file() {
    let introduction = "These are the keys of the file of `gdp-proxy`. It is strict YAML: unknown keys are errors. \
                        The proxy reads it again when it changes, or at SIGHUP. Relative paths are relative to its \
                        folder. [ROS topics, services and actions](../ros.md) has examples. For editors there is \
                        [gdp-proxy.schema.json](../gdp-proxy.schema.json).";
    let page = file_keys::write("The proxy's file", introduction, &schema().into());
    reference::check("docs/reference/proxy-file.md", &page);
}

/// Parts of a file get the keys without which there is none.
#[test]
fn the_files_in_documents_are_good() {
    for (at, text) in gdp_tests::book::files("proxy.yaml").unwrap() {
        let lacks = |key: &&str| !text.lines().any(|line| line.split(':').next() == key.split(':').next());
        let required = ["version: 1", "identity: id.pem", "links: [{to: 'udp://h:31415'}]"];
        let whole: String = required.iter().filter(|line| lacks(line)).map(|line| format!("{line}\n")).collect();
        let whole = whole + &text;
        Config::parse(&whole, Path::new("proxy.yaml")).unwrap_or_else(|error| panic!("{at}: {error}"));
    }
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
