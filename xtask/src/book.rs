//! `cargo xtask book`: builds the documents as a book, in the folder `book`.
//!
//! `docs/SUMMARY.md` is its list of contents. Nothing else needs mdBook: CI checks links, pages and
//! commands without it.

use anyhow::Result;
use gdp_tests::programs::own;

use crate::{shell, workspace};

/// The release of mdBook, from crates.io.
const VERSION: &str = "0.5.4";

#[derive(clap::Args)]
pub struct Options {}

pub fn run(_: Options) -> Result<()> {
    let folder = workspace::target().join("mdbook").join(VERSION);
    let mdbook = folder.join("bin/mdbook");
    if !mdbook.is_file() {
        eprintln!("mdBook {VERSION} is missing: cargo compiles it once, in about a minute");
        let mut install = shell::cargo();
        install.args(["install", "--locked", "--no-default-features", "--features", "search", "--root"]);
        shell::say_and_run(install.arg(&folder).arg(format!("mdbook@{VERSION}")))?;
    }
    shell::run(own(&mdbook).arg("build").arg(workspace::root()))?;
    println!("{}", workspace::root().join("book/index.html").display());
    Ok(())
}
