//! Rules on the documents: links resolve, every page is in the book, and blocks say what they are.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::Result;
use gdp_tests::book::{Block, Document, commands, console, documents, file_of};
use pulldown_cmark::{Event, Options, Parser, Tag, TagEnd};

use crate::git::tracked;
use crate::workspace;

const SUMMARY: &str = "docs/SUMMARY.md";
const LONGEST_README: usize = 120;

/// The files of which a `yaml` block may be a part. Tests parse them with the programs' parsers.
const FILES: [&str; 3] = ["gdp.yaml", "proxy.yaml", "fleet.yaml"];

/// Returns the links of tracked Markdown files that lead nowhere.
pub fn broken_links() -> Result<Vec<String>> {
    let mut found = Vec::new();
    let mut anchors = BTreeMap::new();
    for path in tracked("*.md")?.into_iter().filter(|path| !path.starts_with("third_party")) {
        let document = Document::read(&path)?;
        for (at, link) in links(&document) {
            if link.contains("://") || link.starts_with("mailto:") {
                continue;
            }
            let (file, anchor) = link.split_once('#').unwrap_or((&link, ""));
            let folder = path.parent().unwrap_or(Path::new(""));
            let target = if file.is_empty() { path.clone() } else { normal(&folder.join(file)) };
            if !workspace::root().join(&target).exists() {
                found.push(format!("{at}: {link}: there is no {}", target.display()));
            } else if path.starts_with("docs") && !target.starts_with("docs") && is_page(&target) {
                found.push(format!("{at}: {link}: mdBook expects a page of the book; link to its folder"));
            } else if !anchor.is_empty() && is_page(&target) {
                let known = match anchors.get(&target) {
                    Some(known) => known,
                    None => anchors.entry(target.clone()).or_insert(anchors_of(&Document::read(&target)?)),
                };
                if !known.contains(anchor) {
                    found.push(format!("{at}: {link}: there is no such heading"));
                }
            }
        }
    }
    Ok(found)
}

fn is_page(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "md")
}

/// Returns the pages that the book lacks or has twice, and a README that is too long.
pub fn pages() -> Result<Vec<String>> {
    let mut listed: BTreeMap<PathBuf, usize> = BTreeMap::new();
    for (_, link) in links(&Document::read(SUMMARY)?) {
        *listed.entry(Path::new("docs").join(link)).or_default() += 1;
    }
    let pages = tracked("docs/*.md")?.into_iter().filter(|path| path != Path::new(SUMMARY));
    let count = |path: PathBuf| (listed.get(&path).copied().unwrap_or(0), path);
    let wrong = pages.map(count).filter(|(count, _)| *count != 1);
    let mut found: Vec<String> =
        wrong.map(|(count, path)| format!("{}: {count} times in {SUMMARY}", path.display())).collect();
    let lines = Document::read("README.md")?.text.lines().count();
    if lines > LONGEST_README {
        found.push(format!("README.md: {lines} lines, {LONGEST_README} at most"));
    }
    Ok(found)
}

/// Returns the fenced blocks that do not say what they are.
pub fn blocks() -> Result<Vec<String>> {
    let mut found = Vec::new();
    for document in documents()? {
        found.extend(document.blocks().iter().filter_map(problem));
    }
    Ok(found)
}

fn problem(block: &Block) -> Option<String> {
    let reason = match block.language.as_str() {
        "" => "a language is missing after the fence; `text` is one".to_owned(),
        "console" if block.text.lines().next().and_then(console::typed).is_none() => {
            "the first line has no prompt such as `robot7$ `".to_owned()
        }
        "yaml" if !file_of(block).is_some_and(|file| FILES.contains(&file)) => {
            format!("the first line is none of the comments {}", FILES.map(|file| format!("`# {file}`")).join(", "))
        }
        _ => return None,
    };
    Some(format!("{}: {reason}", block.at))
}

/// Returns the commands `cargo xtask` in documents that do not exist.
pub fn commands(xtask: &clap::Command) -> Result<Vec<String>> {
    let cargo = clap::Command::new("cargo").allow_external_subcommands(true);
    commands::problems("cargo", &cargo.subcommand(xtask.clone().name("xtask")))
}

/// Returns the links and images of a document, each with its path and line.
fn links(document: &Document) -> Vec<(String, String)> {
    let events = Parser::new_ext(&document.text, Options::ENABLE_TABLES).into_offset_iter();
    let links = events.filter_map(|(event, range)| match event {
        Event::Start(Tag::Link { dest_url, .. } | Tag::Image { dest_url, .. }) => {
            Some((document.at(range.start), dest_url.into_string()))
        }
        _ => None,
    });
    links.collect()
}

/// Returns the anchors of a document's headings, as GitHub and mdBook make them.
fn anchors_of(document: &Document) -> BTreeSet<String> {
    let mut anchors = BTreeSet::new();
    let mut heading: Option<String> = None;
    for event in Parser::new_ext(&document.text, Options::ENABLE_TABLES) {
        match event {
            Event::Start(Tag::Heading { .. }) => heading = Some(String::new()),
            Event::Text(text) | Event::Code(text) => heading.iter_mut().for_each(|heading| heading.push_str(&text)),
            Event::End(TagEnd::Heading(_)) => {
                let anchor = heading.take().map(|heading| anchor(&heading)).unwrap_or_default();
                let repeated = (1..).map(|number| format!("{anchor}-{number}"));
                let free = std::iter::once(anchor.clone()).chain(repeated).find(|anchor| !anchors.contains(anchor));
                anchors.extend(free);
            }
            _ => {}
        }
    }
    anchors
}

fn anchor(heading: &str) -> String {
    let letters = heading.trim().chars().filter_map(|c| match c {
        ' ' => Some('-'),
        c if c.is_alphanumeric() || c == '-' || c == '_' => Some(c),
        _ => None,
    });
    letters.collect::<String>().to_lowercase()
}

/// Resolves `..` without the file system.
fn normal(path: &Path) -> PathBuf {
    let mut parts = PathBuf::new();
    for part in path.components() {
        match part {
            std::path::Component::ParentDir => _ = parts.pop(),
            std::path::Component::CurDir => {}
            part => parts.push(part),
        }
    }
    parts
}

#[cfg(test)]
#[path = "../../tests/unit/check/book.rs"]
mod tests;
