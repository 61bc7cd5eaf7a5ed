//! The page of a configuration file's keys, from its JSON Schema.

use std::collections::VecDeque;

use serde_json::{Map, Value};

use super::reference::{page, table, wrapped};

/// Returns the page of a file: a table for the file itself and for each mapping in it.
pub fn write(title: &str, introduction: &str, schema: &Value) -> String {
    let mut keys = Keys { root: schema, mappings: VecDeque::new(), seen: Vec::new() };
    let mut body = wrapped(introduction);
    body += "## Keys of the file\n\n";
    body += &keys.table("", schema);
    while let Some((name, path)) = keys.mappings.pop_front() {
        let mapping = &schema["$defs"][&name];
        body += &format!("## `{path}`\n\n");
        body += &wrapped(&plain(description(mapping)));
        body += &keys.table(&path, mapping);
    }
    page(title, &body)
}

struct Keys<'a> {
    root: &'a Value,
    /// Mappings that were mentioned and are not described yet, each with the path of its first key.
    mappings: VecDeque<(String, String)>,
    seen: Vec<(String, String)>,
}

impl Keys<'_> {
    /// # Panics
    ///
    /// If a key has no description.
    fn table(&mut self, path: &str, mapping: &Value) -> String {
        let none = Map::new();
        let properties = mapping["properties"].as_object().unwrap_or(&none);
        let mut names: Vec<&String> = properties.keys().collect();
        let is_required = |name: &String| {
            mapping["required"].as_array().is_some_and(|names| names.contains(&Value::from(name.as_str())))
        };
        names.sort_by_key(|name| (!is_required(name), *name));
        let rows = names.into_iter().map(|name| {
            let property = &properties[name];
            let default = match is_required(name) {
                true => "required".to_owned(),
                false => default(property),
            };
            let text = match description(property) {
                "" => description(self.target(property)).to_owned(),
                text => text.to_owned(),
            };
            assert!(!text.is_empty(), "{path}: {name} needs a doc comment");
            let values = self.described_values(property);
            let path = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
            vec![format!("`{name}`"), self.kind(&path, property), default, format!("{} {values}", plain(&text))]
        });
        let rows: Vec<Vec<String>> = rows.collect();
        table(&["key", "value", "default", "meaning"], &rows)
    }

    /// Returns what the value at a path of keys looks like. Null counts as absent.
    fn kind(&mut self, path: &str, schema: &Value) -> String {
        if let Some(name) = reference(schema) {
            let target = &self.root["$defs"][name];
            if !target["properties"].is_object() {
                return self.kind(path, target);
            }
            let path = match self.seen.iter().find(|(seen, _)| seen == name) {
                Some((_, path)) => path.clone(),
                None => {
                    // Several kinds of mappings may be at one path.
                    let taken = self.seen.iter().filter(|(_, seen)| seen.split(' ').next() == Some(path)).count();
                    let path = if taken == 0 { path.to_owned() } else { format!("{path} ({})", taken + 1) };
                    self.seen.push((name.to_owned(), path.clone()));
                    self.mappings.push_back((name.to_owned(), path.clone()));
                    path
                }
            };
            let anchor: String = path.to_lowercase().replace(' ', "-");
            let anchor = anchor.replace(['.', '(', ')'], "");
            return format!("mapping [{path}](#{anchor})");
        }
        let alternatives = ["anyOf", "oneOf"].iter().find_map(|key| schema[*key].as_array());
        if let Some(alternatives) = alternatives {
            let mut kinds: Vec<String> = alternatives.iter().map(|schema| self.kind(path, schema)).collect();
            kinds.retain(|kind| !kind.is_empty());
            kinds.dedup();
            return kinds.join(" or ");
        }
        if let Some(values) = schema["enum"].as_array() {
            return values.iter().filter(|value| !value.is_null()).map(code).collect::<Vec<_>>().join(" or ");
        }
        if !schema["const"].is_null() {
            return code(&schema["const"]);
        }
        let kind = match &schema["type"] {
            Value::Array(kinds) => kinds.iter().filter_map(Value::as_str).find(|kind| *kind != "null"),
            kind => kind.as_str(),
        };
        match kind {
            Some("array") => format!("list of {}", self.kind(path, &schema["items"])),
            Some("object") if schema["additionalProperties"].is_object() => {
                format!("mapping to {}", self.kind(path, &schema["additionalProperties"]))
            }
            Some("object") => "mapping".to_owned(),
            Some("string") => "text".to_owned(),
            Some("integer" | "number") => "number".to_owned(),
            Some("boolean") => "`true` or `false`".to_owned(),
            _ => String::new(),
        }
    }

    /// Returns the values of an enumeration that have descriptions.
    fn described_values(&self, schema: &Value) -> String {
        let target = self.target(schema);
        let described = target["oneOf"].as_array().into_iter().flatten().filter_map(|value| {
            let text = description(value);
            (value["const"].is_string() && !text.is_empty())
                .then(|| format!("{}: {}.", code(&value["const"]), plain(text).trim_end_matches('.')))
        });
        described.collect::<Vec<_>>().join(" ")
    }

    /// Returns the definition that a schema refers to, or the schema itself.
    fn target<'b>(&'b self, schema: &'b Value) -> &'b Value {
        let choices = schema["anyOf"].as_array().into_iter().flatten();
        match reference(schema).or_else(|| choices.filter_map(reference).next()) {
            Some(name) => &self.root["$defs"][name],
            None => schema,
        }
    }
}

fn reference(schema: &Value) -> Option<&str> {
    schema["$ref"].as_str()?.strip_prefix("#/$defs/")
}

fn description(schema: &Value) -> &str {
    schema["description"].as_str().unwrap_or_default()
}

fn default(schema: &Value) -> String {
    match &schema["default"] {
        Value::Null => String::new(),
        Value::Array(items) if items.is_empty() => "none".to_owned(),
        value => code(value),
    }
}

fn code(value: &Value) -> String {
    value.as_str().map_or_else(|| format!("`{value}`"), |text| format!("`{text}`"))
}

/// Returns a text without links that only Rust's documentation has.
fn plain(text: &str) -> String {
    text.replace("[`", "`").replace("`]", "`")
}
