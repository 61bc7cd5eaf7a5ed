//! Rules on sentences: the first one of every file and public item, and all of the documents.

use std::collections::HashMap;
use std::path::PathBuf;

use anyhow::{Context, Result};
use syn::{Attribute, Expr, Item, Lit, Meta, Visibility};

use super::sources::SourceFile;
use crate::git::tracked;
use crate::workspace;

const MOST_WORDS: usize = 25;

/// Returns files without a first sentence, and first sentences of files and public items that are
/// too long.
pub fn findings(product: &HashMap<PathBuf, SourceFile>) -> Vec<String> {
    let mut found: Vec<String> = product.values().flat_map(of_source).collect();
    found.sort();
    found
}

fn of_source(source: &SourceFile) -> Vec<String> {
    let path = source.path.display();
    let mut found = Vec::new();
    match first_sentence(&documentation(&source.syntax.attrs)) {
        None => found.push(format!("{path}: no `//!`")),
        Some(words) if words > MOST_WORDS => found.push(format!("{path}: {words} words in `//!`")),
        Some(_) => {}
    }
    for (name, attributes) in source.syntax.items.iter().filter_map(public) {
        if let Some(words) = first_sentence(&documentation(attributes)).filter(|words| *words > MOST_WORDS) {
            found.push(format!("{path}: {words} words at `{name}`"));
        }
    }
    found
}

/// Returns the sentences of tracked Markdown documents with too many words. Ignores tables and
/// code.
pub fn documents() -> Result<Vec<String>> {
    let mut found = Vec::new();
    for path in tracked("*.md")? {
        if path.starts_with("third_party") {
            continue;
        }
        let file = workspace::root().join(&path);
        let text = std::fs::read_to_string(&file).with_context(|| format!("cannot read {}", file.display()))?;
        let long = paragraphs(&text).into_iter().flat_map(|(line, paragraph)| {
            let sentences: Vec<usize> = sentences(&paragraph).map(|sentence| count_words(&sentence)).collect();
            sentences.into_iter().filter(|words| *words > MOST_WORDS).map(move |words| (line, words))
        });
        found.extend(long.map(|(line, words)| format!("{}:{line}: {words} words", path.display())));
    }
    Ok(found)
}

/// Returns the paragraphs of prose, each with the number of its first line.
fn paragraphs(text: &str) -> Vec<(usize, String)> {
    let mut paragraphs: Vec<(usize, String)> = Vec::new();
    let (mut in_code, mut goes_on) = (false, false);
    for (index, line) in text.lines().enumerate() {
        let line = line.trim();
        let is_fence = line.starts_with("```");
        in_code ^= is_fence;
        let is_prose = !in_code && !is_fence && !line.is_empty() && !line.starts_with(['|', '#', '<']);
        let begins = line.starts_with("- ") || line.starts_with("* ") || line.starts_with(|c: char| c.is_ascii_digit());
        match paragraphs.last_mut() {
            Some((_, paragraph)) if is_prose && goes_on && !begins => {
                paragraph.push(' ');
                paragraph.push_str(line);
            }
            _ if is_prose => paragraphs.push((index + 1, line.to_owned())),
            _ => {}
        }
        goes_on = is_prose;
    }
    paragraphs
}

/// Splits a paragraph into sentences. A sentence ends with a full stop, question mark, exclamation
/// mark or colon before a space.
fn sentences(paragraph: &str) -> impl Iterator<Item = String> {
    let mut sentences = vec![String::new()];
    for word in paragraph.split_whitespace() {
        let current = sentences.last_mut().expect("there is always one");
        current.push_str(word);
        current.push(' ');
        let bare = word.trim_end_matches(['*', '_', '`', ')', '"', '”']);
        let is_abbreviation = ["e.g.", "i.e.", "etc.", "vs."].contains(&bare);
        if bare.ends_with(['.', '?', '!', ':']) && !is_abbreviation {
            sentences.push(String::new());
        }
    }
    sentences.into_iter().filter(|sentence| !sentence.is_empty())
}

/// Returns the number of words of the first sentence, if there is one.
fn first_sentence(text: &str) -> Option<usize> {
    let paragraph = text.trim_start().split("\n\n").next().filter(|paragraph| !paragraph.trim().is_empty())?;
    sentences(paragraph).next().map(|sentence| count_words(&sentence))
}

fn count_words(sentence: &str) -> usize {
    sentence.split_whitespace().filter(|word| word.chars().any(char::is_alphanumeric)).count()
}

fn documentation(attributes: &[Attribute]) -> String {
    let lines = attributes.iter().filter_map(|attribute| {
        let Meta::NameValue(pair) = &attribute.meta else { return None };
        let Expr::Lit(value) = &pair.value else { return None };
        let Lit::Str(text) = &value.lit else { return None };
        pair.path.is_ident("doc").then(|| text.value())
    });
    lines.map(|line| line.trim().to_owned()).collect::<Vec<_>>().join("\n")
}

fn public(item: &Item) -> Option<(String, &[Attribute])> {
    let (visibility, ident, attributes) = match item {
        Item::Const(item) => (&item.vis, &item.ident, &item.attrs),
        Item::Enum(item) => (&item.vis, &item.ident, &item.attrs),
        Item::Fn(item) => (&item.vis, &item.sig.ident, &item.attrs),
        Item::Struct(item) => (&item.vis, &item.ident, &item.attrs),
        Item::Trait(item) => (&item.vis, &item.ident, &item.attrs),
        Item::Type(item) => (&item.vis, &item.ident, &item.attrs),
        _ => return None,
    };
    (!matches!(visibility, Visibility::Inherited)).then(|| (ident.to_string(), attributes.as_slice()))
}
