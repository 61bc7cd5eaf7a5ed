//! Rules on names: type names that are defined too often, and words that are not terms of the
//! field.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use syn::visit::{self, Visit};
use syn::{Ident, Item};

use super::sources::{SourceFile, is_for_tests};

const MOST_DEFINITIONS: usize = 3;

/// Retired words, which replaced terms of the field. No name of a definition may contain one.
const RETIRED: [&str; 46] = [
    "abroad",
    "anew",
    "beside",
    "books",
    "came",
    "chore",
    "complain",
    "desk",
    "dress",
    "fate",
    "gathered",
    "given",
    "gone",
    "growing",
    "heard",
    "heed",
    "held",
    "hold",
    "hurry",
    "intake",
    "judge",
    "kept",
    "keeper",
    "lately",
    "luck",
    "manner",
    "moment",
    "onlooker",
    "outlet",
    "papers",
    "party",
    "parties",
    "patience",
    "place",
    "places",
    "shown",
    "speaker",
    "stake",
    "standing",
    "strangers",
    "strays",
    "telling",
    "told",
    "twins",
    "unserved",
    "vouch",
];

/// Type names that each module may define by convention.
const CONVENTIONAL: [&str; 5] = ["Options", "Error", "Result", "Command", "Config"];

/// Returns the type names that the product defines more than three times.
pub fn repeated_types(product: &HashMap<PathBuf, SourceFile>) -> Vec<String> {
    let mut definitions: BTreeMap<String, Vec<&Path>> = BTreeMap::new();
    for source in product.values() {
        for name in source.syntax.items.iter().filter_map(type_name) {
            definitions.entry(name).or_default().push(&source.path);
        }
    }
    let often = definitions
        .into_iter()
        .filter(|(name, files)| files.len() > MOST_DEFINITIONS && !CONVENTIONAL.contains(&name.as_str()));
    often.map(|(name, files)| format!("{name}: {}", list(files))).collect()
}

fn list(mut files: Vec<&Path>) -> String {
    files.sort();
    files.iter().map(|file| file.display().to_string()).collect::<Vec<_>>().join(", ")
}

fn type_name(item: &Item) -> Option<String> {
    match item {
        Item::Enum(item) => Some(item.ident.to_string()),
        Item::Struct(item) => Some(item.ident.to_string()),
        Item::Trait(item) => Some(item.ident.to_string()),
        Item::Type(item) => Some(item.ident.to_string()),
        _ => None,
    }
}

/// Returns the definitions and files whose name contains a word of [`RETIRED`].
pub fn retired_words(product: &HashMap<PathBuf, SourceFile>) -> Vec<String> {
    let mut found = Vec::new();
    for source in product.values() {
        let stem = source.path.with_extension("");
        let parts = stem.iter().skip(1).map(|part| part.to_string_lossy().into_owned());
        let mut names = DefinedNames(parts.filter(|part| part != "mod").collect());
        names.visit_file(&source.syntax);
        found.extend(
            names.0.iter().filter(|name| is_retired(name)).map(|name| format!("{}: {name}", source.path.display())),
        );
    }
    found.sort();
    found.dedup();
    found
}

fn is_retired(name: &str) -> bool {
    words(name).iter().any(|word| RETIRED.contains(&word.as_str()))
}

/// Returns the words of a `snake_case` or `CamelCase` name in lower case.
fn words(name: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    for letter in name.chars() {
        let begins = letter == '_' || letter == '-' || letter == '.' || letter.is_uppercase();
        if begins && words.last().is_some_and(|word| !word.is_empty() && !word.ends_with(char::is_uppercase)) {
            words.push(String::new());
        }
        if letter.is_alphanumeric() {
            words.last_mut().expect("there is always one").push(letter);
        }
    }
    words.into_iter().map(|word| word.to_lowercase()).collect()
}

/// Collects the names of all definitions in a file.
struct DefinedNames(Vec<String>);

impl DefinedNames {
    fn add(&mut self, ident: &Ident) {
        self.0.push(ident.to_string());
    }
}

impl<'ast> Visit<'ast> for DefinedNames {
    fn visit_item(&mut self, item: &'ast Item) {
        match item {
            Item::Mod(module) if is_for_tests(&module.attrs) => return,
            Item::Const(item) => self.add(&item.ident),
            Item::Enum(item) => self.add(&item.ident),
            Item::Mod(item) => self.add(&item.ident),
            Item::Static(item) => self.add(&item.ident),
            Item::Struct(item) => self.add(&item.ident),
            Item::Trait(item) => self.add(&item.ident),
            Item::Type(item) => self.add(&item.ident),
            _ => {}
        }
        visit::visit_item(self, item);
    }

    fn visit_signature(&mut self, signature: &'ast syn::Signature) {
        self.add(&signature.ident);
        visit::visit_signature(self, signature);
    }

    fn visit_field(&mut self, field: &'ast syn::Field) {
        field.ident.iter().for_each(|ident| self.add(ident));
    }

    fn visit_variant(&mut self, variant: &'ast syn::Variant) {
        self.add(&variant.ident);
        visit::visit_variant(self, variant);
    }
}
