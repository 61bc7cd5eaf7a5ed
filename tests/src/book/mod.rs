//! The documents: README, CONTRIBUTING and the pages of the book in `docs`.
//!
//! - [`commands`]: checks that the commands in documents exist, with their options
//! - [`console`]: what people type and read in a terminal, by machine
//! - [`reference`]: pages that are written from the code; [`command_line`] and [`file_keys`] are
//!   two kinds of them

pub mod command_line;
pub mod commands;
pub mod console;
pub mod file_keys;
pub mod reference;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use pulldown_cmark::{CodeBlockKind, Event, Options, Parser, Tag, TagEnd};

/// A Markdown file.
pub struct Document {
    /// The path relative to the root of the source tree.
    pub path: PathBuf,
    pub text: String,
}

/// A fenced block of a document.
pub struct Block {
    /// What follows the opening fence.
    pub language: String,
    /// The path and line of the opening fence, for messages.
    pub at: String,
    pub text: String,
}

/// Returns the root of the source tree.
pub fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

/// Returns README, CONTRIBUTING and every page of `docs`, ordered by path.
pub fn documents() -> Result<Vec<Document>> {
    let mut paths = vec![PathBuf::from("README.md"), PathBuf::from("CONTRIBUTING.md")];
    let mut folders = vec![PathBuf::from("docs")];
    while let Some(folder) = folders.pop() {
        let full = root().join(&folder);
        for entry in std::fs::read_dir(&full).with_context(|| format!("cannot read {}", full.display()))? {
            let entry = entry?;
            let path = folder.join(entry.file_name());
            if entry.file_type()?.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "md") {
                paths.push(path);
            }
        }
    }
    paths.sort();
    paths.into_iter().map(Document::read).collect()
}

impl Document {
    /// Reads a file, by its path relative to the root of the source tree.
    pub fn read(path: impl Into<PathBuf>) -> Result<Self> {
        let path = path.into();
        let file = root().join(&path);
        let text = std::fs::read_to_string(&file).with_context(|| format!("cannot read {}", file.display()))?;
        Ok(Self { path, text })
    }

    /// Returns the path and line of a position in the text, for messages.
    pub fn at(&self, position: usize) -> String {
        format!("{}:{}", self.path.display(), 1 + self.text[..position].matches('\n').count())
    }

    /// Returns the fenced blocks in their order.
    pub fn blocks(&self) -> Vec<Block> {
        let mut blocks = Vec::new();
        let mut open: Option<Block> = None;
        for (event, range) in Parser::new_ext(&self.text, Options::ENABLE_TABLES).into_offset_iter() {
            match event {
                Event::Start(Tag::CodeBlock(CodeBlockKind::Fenced(language))) => {
                    open =
                        Some(Block { language: language.into_string(), at: self.at(range.start), text: String::new() });
                }
                Event::Text(text) => open.iter_mut().for_each(|block| block.text.push_str(&text)),
                Event::End(TagEnd::CodeBlock) => blocks.extend(open.take()),
                _ => {}
            }
        }
        blocks
    }

    /// Returns the code in running text and tables, with its path and line.
    pub fn inline_code(&self) -> Vec<(String, String)> {
        let events = Parser::new_ext(&self.text, Options::ENABLE_TABLES).into_offset_iter();
        let code = events.filter_map(|(event, range)| match event {
            Event::Code(text) => Some((self.at(range.start), text.into_string())),
            _ => None,
        });
        code.collect()
    }
}

/// Returns the YAML blocks whose first line is the comment `# FILE`, each with its path and line.
///
/// # Errors
///
/// If no document has such a block.
pub fn files(name: &str) -> Result<Vec<(String, String)>> {
    let mut found = Vec::new();
    for document in documents()? {
        let blocks = document.blocks().into_iter();
        let of_file = blocks.filter(|block| block.language == "yaml" && file_of(block) == Some(name));
        found.extend(of_file.map(|block| (block.at, block.text.replace("64_HEX_DIGITS", &"0a".repeat(32)))));
    }
    anyhow::ensure!(!found.is_empty(), "no document has a YAML block that begins with `# {name}`");
    Ok(found)
}

/// Returns the name of the file that a block is, or is a part of.
pub fn file_of(block: &Block) -> Option<&str> {
    block.text.lines().next()?.strip_prefix("# ")
}
