//! Reads and parses the product's source files once, for all rules of `cargo xtask check`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use syn::{Attribute, File};

use crate::git::tracked;
use crate::workspace;

/// One `.rs` file of the product, without its tests.
pub struct SourceFile {
    /// The path relative to the workspace's root.
    pub path: PathBuf,
    pub text: String,
    pub syntax: File,
}

/// Folders whose Rust files are not part of the product.
const NOT_PRODUCT: [&str; 3] = ["tests", "fuzz", "third_party"];

/// Returns every product file that Git tracks, ordered by path.
pub fn product() -> Result<Vec<SourceFile>> {
    let mut sources = Vec::new();
    for path in tracked("*.rs")? {
        if is_product(&path) {
            sources.push(read(path)?);
        }
    }
    ensure!(!sources.is_empty(), "Git tracks no Rust file under {}", workspace::root().display());
    Ok(sources)
}

/// Returns whether a file is below a `src` folder or is a build script, and in no excluded folder.
fn is_product(path: &Path) -> bool {
    let mut folders = path.iter().map(|part| part.to_string_lossy());
    let top = folders.next().unwrap_or_default();
    !NOT_PRODUCT.contains(&top.as_ref()) && (path.ends_with("build.rs") || folders.any(|folder| folder == "src"))
}

fn read(path: PathBuf) -> Result<SourceFile> {
    let file = workspace::root().join(&path);
    let text = std::fs::read_to_string(&file).with_context(|| format!("cannot read {}", file.display()))?;
    let syntax = syn::parse_file(&text).with_context(|| format!("cannot parse {}", file.display()))?;
    Ok(SourceFile { path, text, syntax })
}

/// Returns whether an item with these attributes is compiled only for tests.
pub fn is_for_tests(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        attribute.path().is_ident("cfg")
            && attribute.parse_args::<syn::Ident>().is_ok_and(|condition| condition == "test")
    })
}
