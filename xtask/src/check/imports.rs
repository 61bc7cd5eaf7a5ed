//! Finds import cycles: files of one crate that use each other's definitions, as strongly connected
//! components.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};

use petgraph::algo::tarjan_scc;
use petgraph::graphmap::DiGraphMap;
use proc_macro2::{TokenStream, TokenTree};
use quote::ToTokens as _;
use syn::visit::{self, Visit};
use syn::{Item, ItemUse, Macro, UseTree, Visibility};

use super::modules::Crate;
use super::sources::{SourceFile, is_for_tests};

/// The names that one file uses of another.
pub type Edges<'a> = BTreeMap<(&'a Path, &'a Path), BTreeSet<String>>;

/// A cycle: its files, and the names that connect them.
pub struct Circle<'a> {
    pub files: Vec<&'a Path>,
    pub edges: Edges<'a>,
}

/// Returns the cycles of every crate. `sources` are the product's files by path.
pub fn circles(sources: &HashMap<PathBuf, SourceFile>) -> Vec<Circle<'_>> {
    let mut roots: Vec<&SourceFile> = sources.values().filter(|source| is_root(&source.path)).collect();
    roots.sort_by(|a, b| a.path.cmp(&b.path));
    roots.into_iter().flat_map(|root| of_crate(&edges(&Crate::read(root, sources)))).collect()
}

fn is_root(path: &Path) -> bool {
    let Some(folder) = path.parent() else { return false };
    let is_named = path.ends_with("src/lib.rs") || path.ends_with("src/main.rs");
    is_named || folder.ends_with("src/bin") || path.ends_with("build.rs")
}

fn of_crate<'a>(edges: &Edges<'a>) -> Vec<Circle<'a>> {
    let graph: DiGraphMap<&Path, ()> = edges.keys().map(|(from, to)| (*from, *to, ())).collect();
    let components = tarjan_scc(&graph).into_iter().filter(|files| files.len() > 1);
    let circle = |mut files: Vec<&'a Path>| {
        files.sort();
        let inside = |(from, to): &(&Path, &Path)| files.contains(from) && files.contains(to);
        let edges = edges.iter().filter(|(pair, _)| inside(pair)).map(|(pair, names)| (*pair, names.clone())).collect();
        Circle { files, edges }
    };
    components.map(circle).collect()
}

fn edges<'a>(tree: &Crate<'a>) -> Edges<'a> {
    let mut edges = Edges::new();
    for (path, module) in &tree.modules {
        let mut uses = Uses { tree, module: path, file: module.file, edges: &mut edges };
        module.items.iter().filter(|item| !matches!(item, Item::Mod(_))).for_each(|item| uses.visit_item(item));
        uses.reexports_used_here(module.items);
    }
    edges
}

struct Uses<'t, 'a> {
    tree: &'t Crate<'a>,
    module: &'t [String],
    file: &'a Path,
    edges: &'t mut Edges<'a>,
}

impl Uses<'_, '_> {
    fn path(&mut self, path: &[String]) {
        let Some(absolute) = self.tree.absolute(self.module, path) else { return };
        // An imported module counts only where one of its items is used.
        if self.tree.is_module(&absolute) {
            return;
        }
        let Some(definer) = self.tree.definer(&absolute) else { return };
        if definer != self.file {
            let names = self.edges.entry((self.file, definer)).or_default();
            names.extend(absolute.last().cloned());
        }
    }

    fn imported(&mut self, mut path: Vec<String>, tree: &UseTree) {
        match tree {
            UseTree::Path(part) => {
                path.push(part.ident.to_string());
                self.imported(path, &part.tree);
            }
            UseTree::Name(name) if name.ident == "self" => self.path(&path),
            UseTree::Name(name) => {
                path.push(name.ident.to_string());
                self.path(&path);
            }
            UseTree::Rename(renamed) => {
                path.push(renamed.ident.to_string());
                self.path(&path);
            }
            UseTree::Group(group) => group.items.iter().for_each(|tree| self.imported(path.clone(), tree)),
            UseTree::Glob(_) => {}
        }
    }

    /// Adds re-exports that the module itself uses. Other re-exports do not connect a module to its
    /// child.
    fn reexports_used_here(&mut self, items: &[Item]) {
        let is_other = |item: &&Item| !matches!(item, Item::Use(_) | Item::Mod(_)) && !is_test_item(item);
        let mut words = BTreeSet::new();
        items.iter().filter(is_other).for_each(|item| collect_words(item.to_token_stream(), &mut words));
        let module = &self.tree.modules[self.module];
        let reexports = module.imports.iter().filter(|(name, import)| import.is_reexport && words.contains(*name));
        let paths: Vec<Vec<String>> = reexports.map(|(_, import)| import.path.clone()).collect();
        paths.iter().for_each(|path| self.path(path));
    }

    /// Finds paths in a macro's input, which `syn` does not parse.
    fn tokens(&mut self, tokens: TokenStream) {
        let mut path: Vec<String> = Vec::new();
        let mut colons = 0;
        for token in tokens {
            match token {
                TokenTree::Ident(ident) if path.is_empty() || colons == 2 => {
                    path.push(ident.to_string());
                    colons = 0;
                }
                TokenTree::Punct(punct) if punct.as_char() == ':' && !path.is_empty() => colons += 1,
                other => {
                    self.finish(&mut path);
                    colons = 0;
                    match other {
                        TokenTree::Group(group) => self.tokens(group.stream()),
                        TokenTree::Ident(ident) => path.push(ident.to_string()),
                        _ => {}
                    }
                }
            }
        }
        self.finish(&mut path);
    }

    fn finish(&mut self, path: &mut Vec<String>) {
        if path.len() > 1 {
            self.path(path);
        }
        path.clear();
    }
}

impl<'ast> Visit<'ast> for Uses<'_, '_> {
    fn visit_item(&mut self, item: &'ast Item) {
        if !is_test_item(item) {
            visit::visit_item(self, item);
        }
    }

    fn visit_item_use(&mut self, item: &'ast ItemUse) {
        if matches!(item.vis, Visibility::Inherited) {
            self.imported(Vec::new(), &item.tree);
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let segments: Vec<String> = path.segments.iter().map(|segment| segment.ident.to_string()).collect();
        if segments.len() > 1 {
            self.path(&segments);
        }
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, invoked: &'ast Macro) {
        self.tokens(invoked.tokens.clone());
        visit::visit_macro(self, invoked);
    }
}

fn is_test_item(item: &Item) -> bool {
    let attributes = match item {
        Item::Const(item) => &item.attrs,
        Item::Enum(item) => &item.attrs,
        Item::Fn(item) => &item.attrs,
        Item::Impl(item) => &item.attrs,
        Item::Mod(item) => &item.attrs,
        Item::Static(item) => &item.attrs,
        Item::Struct(item) => &item.attrs,
        Item::Use(item) => &item.attrs,
        _ => return false,
    };
    is_for_tests(attributes)
}

fn collect_words(tokens: TokenStream, words: &mut BTreeSet<String>) {
    for token in tokens {
        match token {
            TokenTree::Ident(ident) => {
                words.insert(ident.to_string());
            }
            TokenTree::Group(group) => collect_words(group.stream(), words),
            _ => {}
        }
    }
}
