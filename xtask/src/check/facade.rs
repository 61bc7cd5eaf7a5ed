//! The rule on the crate `gdp`: it exports at most 60 items beside the module marked unstable. All
//! are re-exports, also those in a module.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use syn::{Item, UseTree, Visibility};

use super::sources::SourceFile;

const FACADE: &str = "gdp/src/lib.rs";
const MOST_ITEMS: usize = 60;
/// The public module for other crates of this workspace, without a stability promise.
const UNSTABLE: &str = "unstable";

pub fn findings(product: &HashMap<PathBuf, SourceFile>) -> Vec<String> {
    let Some(facade) = product.get(Path::new(FACADE)) else { return vec![format!("{FACADE} does not exist")] };
    let mut found = Vec::new();
    let shown = count(&facade.syntax.items, &mut found);
    if shown > MOST_ITEMS {
        found.push(format!("{FACADE}: {shown} items"));
    }
    found
}

/// Returns the number of public re-exports, and adds the public modules that are files.
fn count(items: &[Item], found: &mut Vec<String>) -> usize {
    let mut shown = 0;
    for item in items {
        match item {
            Item::Use(item) if is_public(&item.vis) => shown += names(&item.tree),
            Item::Mod(module) if is_public(&module.vis) && module.ident != UNSTABLE => match &module.content {
                Some((_, items)) => shown += count(items, found),
                None => found.push(format!("{FACADE}: `pub mod {}`", module.ident)),
            },
            _ => {}
        }
    }
    shown
}

fn is_public(visibility: &Visibility) -> bool {
    matches!(visibility, Visibility::Public(_))
}

/// Returns the number of names that a `use` imports. A glob counts as too many.
fn names(tree: &UseTree) -> usize {
    match tree {
        UseTree::Path(part) => names(&part.tree),
        UseTree::Name(_) | UseTree::Rename(_) => 1,
        UseTree::Group(group) => group.items.iter().map(names).sum(),
        UseTree::Glob(_) => MOST_ITEMS + 1,
    }
}
