//! Checks that a JSON value matches a schema and has no key that the schema does not name. Covers
//! the schemas that `schemars` generates.

use std::collections::BTreeSet;

use serde_json::{Map, Value};

/// Returns the problems of `value`, by path; empty if it matches the schema at `pointer` of `root`.
pub fn problems(root: &Value, pointer: &str, value: &Value) -> Vec<String> {
    let Some(schema) = root.pointer(pointer) else { return vec![format!("no schema at {pointer}")] };
    Schema { root }.of(schema, value, pointer)
}

struct Schema<'a> {
    root: &'a Value,
}

impl Schema<'_> {
    fn of(&self, schema: &Value, value: &Value, path: &str) -> Vec<String> {
        let mut known = BTreeSet::new();
        let mut problems = self.check(schema, value, path, &mut known);
        let keys = value.as_object().into_iter().flat_map(Map::keys);
        problems.extend(keys.filter(|key| !known.contains(*key)).map(|key| format!("{path}: {key} is not described")));
        problems
    }

    /// Adds the keys of `value` that the schema describes to `known`.
    fn check(&self, schema: &Value, value: &Value, path: &str, known: &mut BTreeSet<String>) -> Vec<String> {
        let no_rules = Map::new();
        let rules = schema.as_object().unwrap_or(&no_rules);
        if ["$ref", "allOf", "anyOf", "oneOf", "type", "properties"].iter().all(|key| !rules.contains_key(*key)) {
            known.extend(value.as_object().into_iter().flat_map(|object| object.keys().cloned()));
        }
        let mut problems = Vec::new();
        if let Some(reference) = rules.get("$ref").and_then(Value::as_str) {
            let target = self.root.pointer(reference.trim_start_matches('#')).unwrap_or(&Value::Bool(false));
            problems.extend(self.check(target, value, path, known));
        }
        for part in rules.get("allOf").and_then(Value::as_array).into_iter().flatten() {
            problems.extend(self.check(part, value, path, known));
        }
        for choice in ["anyOf", "oneOf"].iter().filter_map(|key| rules.get(*key)?.as_array()) {
            let tried = choice.iter().map(|one| {
                let mut described = BTreeSet::new();
                let problems = self.check(one, value, path, &mut described);
                (problems, described)
            });
            let best = tried.min_by_key(|(problems, described)| (problems.len(), usize::MAX - described.len()));
            let (wrong, described) = best.unwrap_or_default();
            problems.extend(wrong);
            known.extend(described);
        }
        let types = match rules.get("type") {
            Some(Value::Array(types)) => types.clone(),
            Some(one) => vec![one.clone()],
            None => vec![],
        };
        if !types.is_empty() && !types.iter().any(|name| is_of(name, value)) {
            problems.push(format!("{path}: {value} is not of {types:?}"));
        }
        let allowed = rules.get("enum").and_then(Value::as_array);
        if allowed.is_some_and(|allowed| !allowed.contains(value)) || rules.get("const").is_some_and(|c| c != value) {
            problems.push(format!("{path}: {value} is not one of the words"));
        }
        if let Value::Array(items) = value {
            let prefix = rules.get("prefixItems").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
            for (i, item) in items.iter().enumerate() {
                if let Some(schema) = prefix.get(i).or(rules.get("items")) {
                    problems.extend(self.of(schema, item, &format!("{path}/{i}")));
                }
            }
        }
        if let Value::Object(object) = value {
            let required = rules.get("required").and_then(Value::as_array).into_iter().flatten();
            let missing = required.filter_map(Value::as_str).filter(|key| !object.contains_key(*key));
            problems.extend(missing.map(|key| format!("{path}: {key} is missing")));
            let is_open = types.iter().any(|name| name == "object") && !rules.contains_key("properties");
            for (key, item) in object {
                let named = rules.get("properties").and_then(|properties| properties.get(key));
                if let Some(schema) = named.or_else(|| rules.get("additionalProperties")) {
                    known.insert(key.clone());
                    problems.extend(self.of(schema, item, &format!("{path}/{key}")));
                } else if is_open {
                    known.insert(key.clone());
                }
            }
        }
        problems
    }
}

fn is_of(name: &Value, value: &Value) -> bool {
    match name.as_str() {
        Some("null") => value.is_null(),
        Some("boolean") => value.is_boolean(),
        Some("string") => value.is_string(),
        Some("integer") => value.is_i64() || value.is_u64(),
        Some("number") => value.is_number(),
        Some("array") => value.is_array(),
        Some("object") => value.is_object(),
        _ => false,
    }
}
