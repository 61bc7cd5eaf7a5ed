//! Rules on lines: the length of a file, the width of its lines, and tests outside of `src`.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use syn::Item;

use super::sources::{SourceFile, is_for_tests};
use crate::git::tracked;
use crate::workspace;

const LONGEST_FILE: usize = 500;
const WIDEST_CODE: usize = 120;
const WIDEST_TEXT: usize = 100;

pub fn count(product: &HashMap<PathBuf, SourceFile>) -> usize {
    product.values().map(|source| source.text.lines().count()).sum()
}

pub fn long_files(product: &HashMap<PathBuf, SourceFile>) -> Vec<String> {
    let lengths = product.values().map(|source| (source.text.lines().count(), &source.path));
    let mut long: Vec<_> = lengths.filter(|(length, _)| *length > LONGEST_FILE).collect();
    long.sort_by(|a, b| b.cmp(a));
    long.into_iter().map(|(length, path)| format!("{}: {length} lines", path.display())).collect()
}

/// Returns test modules with their text in a product file, which belong in a separate file.
pub fn tests_in_product(product: &HashMap<PathBuf, SourceFile>) -> Vec<String> {
    let mut found: Vec<String> = product.values().flat_map(inline_tests).collect();
    found.sort();
    found
}

fn inline_tests(source: &SourceFile) -> Vec<String> {
    let modules = source.syntax.items.iter().filter_map(|item| match item {
        Item::Mod(module) if is_for_tests(&module.attrs) => Some(module),
        _ => None,
    });
    let lies_here = |module: &&syn::ItemMod| {
        module.content.is_some() || !module.attrs.iter().any(|attribute| attribute.path().is_ident("path"))
    };
    modules.filter(lies_here).map(|module| format!("{}: mod {}", source.path.display(), module.ident)).collect()
}

pub fn wide_lines() -> Result<Vec<String>> {
    let mut wide = Vec::new();
    for path in tracked("*.rs")?.into_iter().chain(tracked("*.md")?) {
        if path.starts_with("third_party") {
            continue;
        }
        let file = workspace::root().join(&path);
        let text = std::fs::read_to_string(&file).with_context(|| format!("cannot read {}", file.display()))?;
        let is_document = path.extension().is_some_and(|extension| extension == "md");
        wide.extend(if is_document { wide_in_document(&path, &text) } else { wide_in_code(&path, &text) });
    }
    Ok(wide)
}

/// Finds wide lines in code. String literals, drawings, and code in comments may have any width.
fn wide_in_code(path: &Path, text: &str) -> Vec<String> {
    let mut in_code = false;
    let mut wide = Vec::new();
    for (number, line) in numbered(text) {
        let Some(comment) = comment(line) else {
            if width(line) > WIDEST_CODE && !line.contains('"') {
                wide.push(describe(path, (number, line)));
            }
            continue;
        };
        in_code ^= comment.starts_with("```");
        let may_be_wide = in_code || comment.contains("   ");
        if !may_be_wide && width(line) > WIDEST_TEXT {
            wide.push(describe(path, (number, line)));
        }
    }
    wide
}

/// Returns the text of a line that contains only a comment.
fn comment(line: &str) -> Option<&str> {
    let text = line.trim_start().strip_prefix("//")?;
    Some(text.trim_start_matches(['/', '!']).trim())
}

/// Finds wide lines in a document. Tables, code and links may have any width.
fn wide_in_document(path: &Path, text: &str) -> Vec<String> {
    let mut in_code = false;
    let mut wide = Vec::new();
    for (number, line) in numbered(text) {
        in_code ^= line.trim_start().starts_with("```");
        let may_be_wide = in_code || line.trim_start().starts_with('|') || line.contains("](");
        if !may_be_wide && width(line) > WIDEST_TEXT {
            wide.push(describe(path, (number, line)));
        }
    }
    wide
}

fn numbered(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines().enumerate().map(|(index, line)| (index + 1, line))
}

fn width(line: &str) -> usize {
    line.chars().count()
}

fn describe(path: &Path, (number, line): (usize, &str)) -> String {
    format!("{}:{number}: {} columns", path.display(), width(line))
}
