//! `cargo xtask check`: checks rules of the source tree that the compiler does not check. It takes
//! seconds.

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

/// Maximum number of findings that are printed for a rule over its limit, without `--all`.
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
    /// Number of findings when the rule was introduced. It must be lowered with every finding that
    /// is removed.
    limit: usize,
    findings: Vec<String>,
}

pub fn run(options: Options) -> Result<()> {
    let product: HashMap<PathBuf, SourceFile> =
        sources::product()?.into_iter().map(|source| (source.path.clone(), source)).collect();
    let rules = [
        Rule { name: "files of one crate import each other in a circle", limit: 0, findings: circles(&product) },
        Rule { name: "a product file has more than 500 lines", limit: 0, findings: lines::long_files(&product) },
        Rule { name: "test code lies in a product's src", limit: 0, findings: lines::tests_in_product(&product) },
        Rule {
            name: "a line is too wide (code 120, comments and documents 100)",
            limit: 0,
            findings: lines::wide_lines()?,
        },
        Rule {
            name: "a file's or item's first sentence is missing or over 25 words",
            limit: 0,
            findings: prose::findings(&product),
        },
        Rule { name: "a document's sentence has more than 25 words", limit: 0, findings: prose::documents()? },
        Rule {
            name: "a type name is defined more than three times",
            limit: 3,
            findings: names::repeated_types(&product),
        },
        Rule { name: "a word of the list that may not come back", limit: 18, findings: names::retired_words(&product) },
        Rule { name: "the facade shows more than 60 items", limit: 0, findings: facade::findings(&product) },
        Rule { name: "a crate depends on what it must not", limit: 0, findings: dependencies::findings()? },
    ];
    for rule in &rules {
        rule.print(options.all);
    }
    println!("{} product files, {} lines", product.len(), lines::count(&product));
    match rules.iter().filter(|rule| rule.findings.len() > rule.limit).count() {
        0 => Ok(()),
        broken => bail!("{broken} of {} rules have more findings than their limit", rules.len()),
    }
}

impl Rule {
    fn print(&self, all: bool) {
        println!("{:5} of {:<4} {}", self.findings.len(), self.limit, self.name);
        if self.findings.len() < self.limit {
            println!("         lower the limit in xtask/src/check/mod.rs to {}", self.findings.len());
        }
        // Findings within the limit are old, so they are not printed.
        let shown = match self.findings.len() > self.limit {
            _ if all => self.findings.len(),
            true => MAX_PRINTED,
            false => 0,
        };
        self.findings.iter().take(shown).for_each(|finding| println!("         {finding}"));
        if shown > 0 && self.findings.len() > shown {
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
