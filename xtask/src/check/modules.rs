//! Reads the module tree of one crate, and finds the file that defines a path.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use syn::{Attribute, Expr, Item, ItemMod, Lit, Meta, UseTree, Visibility};

use super::sources::{SourceFile, is_for_tests};

/// A module's path inside its crate, which is empty for the root.
pub type ModulePath = Vec<String>;

/// The declarations of one module. An inline module has the file of the module around it.
pub struct Module<'a> {
    pub file: &'a Path,
    pub items: &'a [Item],
    /// The imports of `use` by local name.
    pub imports: HashMap<String, Import>,
    /// The modules that glob imports name.
    globs: Vec<Vec<String>>,
    defined: Vec<String>,
}

pub struct Import {
    pub path: Vec<String>,
    /// Whether other modules may import the name from here.
    pub is_reexport: bool,
}

/// All modules of a crate, by path.
pub struct Crate<'a> {
    pub modules: BTreeMap<ModulePath, Module<'a>>,
}

impl<'a> Crate<'a> {
    /// Reads the modules of a crate. `root` is its `lib.rs` or `main.rs`. Skips modules that are
    /// compiled only for tests.
    pub fn read(root: &'a SourceFile, sources: &'a HashMap<PathBuf, SourceFile>) -> Self {
        let mut modules = BTreeMap::new();
        add(&mut modules, sources, Vec::new(), &root.path, &root.syntax.items, &folder_of_root(&root.path));
        Self { modules }
    }

    /// Returns the file that defines `path`, which starts at the crate's root. Follows re-exports.
    pub fn definer(&self, path: &[String]) -> Option<&'a Path> {
        self.follow(path, 0)
    }

    /// Makes a path that is written in `module` absolute. Returns `None` for a path outside the
    /// crate.
    pub fn absolute(&self, module: &[String], path: &[String]) -> Option<Vec<String>> {
        let rest = |from: usize| path[from..].iter().cloned();
        match path.first()?.as_str() {
            "crate" => Some(rest(1).collect()),
            "self" => Some(module.iter().cloned().chain(rest(1)).collect()),
            "super" => {
                let ups = path.iter().take_while(|part| *part == "super").count();
                let above = module.get(..module.len().checked_sub(ups)?)?;
                Some(above.iter().cloned().chain(rest(ups)).collect())
            }
            first => {
                let child: Vec<String> = module.iter().cloned().chain([first.to_owned()]).collect();
                if self.modules.contains_key(&child) {
                    return Some(child.into_iter().chain(rest(1)).collect());
                }
                let import = self.modules.get(module)?.imports.get(first)?;
                // Following an import of an external crate's name would never end.
                (import.path.first().map(String::as_str) != Some(first)).then_some(())?;
                let target = self.absolute(module, &import.path)?;
                Some(target.into_iter().chain(rest(1)).collect())
            }
        }
    }

    /// Returns whether `path` names a module.
    pub fn is_module(&self, path: &[String]) -> bool {
        self.modules.contains_key(path)
    }

    fn follow(&self, path: &[String], depth: usize) -> Option<&'a Path> {
        let known = (0..=path.len()).rev().find(|length| self.modules.contains_key(&path[..*length]))?;
        let (here, module) = (&path[..known], &self.modules[&path[..known]]);
        let Some(name) = path.get(known) else { return Some(module.file) };
        // A chain of re-exports is short; a cycle of them does not compile.
        if depth > 8 || module.defined.contains(name) {
            return Some(module.file);
        }
        if let Some(import) = module.imports.get(name) {
            return match self.absolute(here, &import.path) {
                Some(target) => self.follow(&target, depth + 1),
                None => Some(module.file),
            };
        }
        let globbed = module.globs.iter().filter_map(|glob| self.absolute(here, glob));
        let holder = globbed.filter_map(|glob| Some((self.modules.get(&glob)?, glob)));
        let mut definers = holder.filter(|(holder, _)| holder.defines(name)).map(|(_, glob)| glob);
        match definers.next() {
            Some(glob) => self.follow(&glob.into_iter().chain([name.clone()]).collect::<Vec<_>>(), depth + 1),
            None => Some(module.file),
        }
    }
}

impl Module<'_> {
    fn defines(&self, name: &String) -> bool {
        self.defined.contains(name) || self.imports.get(name).is_some_and(|import| import.is_reexport)
    }
}

fn add<'a>(
    modules: &mut BTreeMap<ModulePath, Module<'a>>,
    sources: &'a HashMap<PathBuf, SourceFile>,
    path: ModulePath,
    file: &'a Path,
    items: &'a [Item],
    folder: &Path,
) {
    let mut module = Module {
        file,
        items,
        imports: HashMap::new(),
        globs: Vec::new(),
        defined: items.iter().filter_map(name).collect(),
    };
    for item in items {
        match item {
            Item::Use(item) if !is_for_tests(&item.attrs) => {
                let is_reexport = !matches!(item.vis, Visibility::Inherited);
                module.import(Vec::new(), &item.tree, is_reexport);
            }
            Item::Mod(child) if !is_for_tests(&child.attrs) => {
                let name = child.ident.to_string();
                let below = path.iter().cloned().chain([name.clone()]).collect();
                match (&child.content, file_of(child, folder, sources)) {
                    (Some((_, items)), _) => add(modules, sources, below, file, items, &folder.join(&name)),
                    (None, Some(source)) => {
                        add(modules, sources, below, &source.path, &source.syntax.items, &folder.join(&name))
                    }
                    (None, None) => {}
                }
            }
            _ => {}
        }
    }
    modules.insert(path, module);
}

impl Module<'_> {
    fn import(&mut self, mut path: Vec<String>, tree: &UseTree, is_reexport: bool) {
        match tree {
            UseTree::Path(part) => {
                path.push(part.ident.to_string());
                self.import(path, &part.tree, is_reexport);
            }
            UseTree::Name(name) if name.ident == "self" => {
                let Some(last) = path.last().cloned() else { return };
                self.imports.insert(last, Import { path, is_reexport });
            }
            UseTree::Name(name) => {
                path.push(name.ident.to_string());
                self.imports.insert(name.ident.to_string(), Import { path, is_reexport });
            }
            UseTree::Rename(renamed) => {
                path.push(renamed.ident.to_string());
                self.imports.insert(renamed.rename.to_string(), Import { path, is_reexport });
            }
            UseTree::Glob(_) => self.globs.push(path),
            UseTree::Group(group) => {
                group.items.iter().for_each(|tree| self.import(path.clone(), tree, is_reexport));
            }
        }
    }
}

/// Returns the file of `mod name;`: `name.rs` or `name/mod.rs` in the module's folder, or the path
/// of `#[path]`.
fn file_of<'a>(module: &ItemMod, folder: &Path, sources: &'a HashMap<PathBuf, SourceFile>) -> Option<&'a SourceFile> {
    let name = module.ident.to_string();
    match module.attrs.iter().find_map(path_attribute) {
        Some(path) => sources.get(&folder.join(path)),
        None => {
            sources.get(&folder.join(format!("{name}.rs"))).or_else(|| sources.get(&folder.join(&name).join("mod.rs")))
        }
    }
}

fn path_attribute(attribute: &Attribute) -> Option<String> {
    let Meta::NameValue(pair) = &attribute.meta else { return None };
    let Expr::Lit(value) = &pair.value else { return None };
    let Lit::Str(text) = &value.lit else { return None };
    pair.path.is_ident("path").then(|| text.value())
}

fn folder_of_root(root: &Path) -> PathBuf {
    root.parent().unwrap_or(Path::new("")).to_owned()
}

fn name(item: &Item) -> Option<String> {
    let ident = match item {
        Item::Const(item) => &item.ident,
        Item::Enum(item) => &item.ident,
        Item::Fn(item) => &item.sig.ident,
        Item::Macro(item) => item.ident.as_ref()?,
        Item::Static(item) => &item.ident,
        Item::Struct(item) => &item.ident,
        Item::Trait(item) => &item.ident,
        Item::Type(item) => &item.ident,
        Item::Union(item) => &item.ident,
        _ => return None,
    };
    Some(ident.to_string())
}
