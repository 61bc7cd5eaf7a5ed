//! `cargo xtask check`: checks rules of the source tree that the compiler does not check. It takes
//! seconds.

mod book;
mod cited_tests;
mod dependencies;
mod facade;
mod imports;
mod lines;
mod modules;
mod names;
mod prose;
mod sources;

use std::collections::HashMap;
use std::path::PathBuf;

use anyhow::{Result, bail};

use self::sources::SourceFile;

/// Maximum number of findings that are printed for a rule, without `--all`.
const MAX_PRINTED: usize = 20;

#[derive(clap::Args)]
pub struct Options {
    /// Print every finding, not only the first 20 of each rule
    #[arg(long)]
    all: bool,
}

/// A rule with all its findings.
struct Rule {
    name: &'static str,
    findings: Vec<String>,
}

/// Checks the rules. `xtask` is the command line of this program, which documents mention.
pub fn run(options: Options, xtask: &clap::Command) -> Result<()> {
    let product: HashMap<PathBuf, SourceFile> =
        sources::product()?.into_iter().map(|source| (source.path.clone(), source)).collect();
    let rules = [
        Rule { name: "files of one crate import each other in a circle", findings: circles(&product) },
        Rule { name: "a product file has more than 500 lines", findings: lines::long_files(&product) },
        Rule { name: "test code lies in a product's src", findings: lines::tests_in_product(&product) },
        Rule { name: "a line is too wide (code 120, comments and documents 100)", findings: lines::wide_lines()? },
        Rule {
            name: "a file's or item's first sentence is missing or over 25 words",
            findings: prose::findings(&product),
        },
        Rule { name: "a document's sentence has more than 25 words", findings: prose::documents()? },
        Rule { name: "a link of a document leads nowhere", findings: book::broken_links()? },
        Rule { name: "a page is not once in docs/SUMMARY.md, or README is too long", findings: book::pages()? },
        Rule { name: "a fenced block does not say what it is", findings: book::blocks()? },
        Rule { name: "a document's `cargo xtask` does not exist", findings: book::commands(xtask)? },
        Rule { name: "a document names a test that does not exist", findings: cited_tests::missing()? },
        Rule { name: "a type name is defined more than three times", findings: names::repeated_types(&product) },
        Rule { name: "a word of the list that may not come back", findings: names::retired_words(&product) },
        Rule { name: "the facade shows more than 60 items", findings: facade::findings(&product) },
        Rule { name: "a crate depends on what it must not", findings: dependencies::findings()? },
        Rule {
            name: "a crate is used outside of the folder that is for it",
            findings: dependencies::outside(&product),
        },
    ];
    for rule in &rules {
        rule.print(options.all);
    }
    println!("{} product files, {} lines", product.len(), lines::count(&product));
    match rules.iter().filter(|rule| !rule.findings.is_empty()).count() {
        0 => Ok(()),
        broken => bail!("{broken} of {} rules are broken", rules.len()),
    }
}

impl Rule {
    fn print(&self, all: bool) {
        println!("{:5} {}", self.findings.len(), self.name);
        let printed = if all { self.findings.len() } else { MAX_PRINTED };
        self.findings.iter().take(printed).for_each(|finding| println!("         {finding}"));
        if self.findings.len() > printed {
            println!("         … (--all prints every one)");
        }
    }
}

fn circles(product: &HashMap<PathBuf, SourceFile>) -> Vec<String> {
    let circle = |circle: imports::Circle| {
        let ties = circle.edges.iter().map(|((from, to), names)| {
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            format!("\n           {} uses {} of {}", from.display(), names.join(", "), to.display())
        });
        format!("{} files:{}", circle.files.len(), ties.collect::<String>())
    };
    imports::circles(product).into_iter().map(circle).collect()
}
