//! Writes the source of the patched RustDDS to `OUT_DIR`: the published crate with `patches` applied.

use std::{
    collections::BTreeMap,
    env,
    error::Error,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use diffy::patch_set::{FileOperation, ParseOptions, PatchSet};
use sha2::{Digest, Sha256};

/// Identifies the published package in the output of `cargo metadata`.
const PACKAGE_ID: &str = "registry+https://github.com/rust-lang/crates.io-index#rustdds@0.15.1";

/// SHA-256 over the published files below `src`. Each counts with its path, its length and its text.
const SOURCE_SHA256: &str = "2e7f9c4602dc76e420c70dcc956b85ede39e3ff69b16c03892e7847162c230c2";

/// Text of the files below `src`, by their path in the crate (`src/lib.rs`).
type Source = BTreeMap<String, String>;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=patches");
    println!("cargo::rerun-if-changed=published/Cargo.toml");
    if let Err(error) = run() {
        // Cargo prints one line for each instruction, and only what follows `error=` on that line.
        for line in error.to_string().lines() {
            println!("cargo::error={line}");
        }
    }
}

fn run() -> Result<(), Box<dyn Error>> {
    let here = PathBuf::from(env::var("CARGO_MANIFEST_DIR")?);
    let mut source = published_source(&here)?;
    for patch in files_in(&here.join("patches"))? {
        apply(&patch, &mut source).map_err(|error| format!("{}: {error}", patch.display()))?;
    }
    prepare_for_include(&mut source)?;
    write(&source, Path::new(&env::var("OUT_DIR")?))
}

/// Reads the published crate from where cargo has unpacked it.
fn published_source(here: &Path) -> Result<Source, Box<dyn Error>> {
    // Resolved outside of the checkout, which may be read-only, with the versions of the workspace.
    let package = PathBuf::from(env::var("OUT_DIR")?).join("published");
    fs::create_dir_all(&package)?;
    fs::write(package.join("Cargo.toml"), fs::read(here.join("published/Cargo.toml"))?)?;
    fs::write(package.join("Cargo.lock"), fs::read(here.join("../../Cargo.lock"))?)?;
    // Without the network where that suffices, so that an offline build works.
    let metadata = match cargo_metadata(&package, here, &["--offline"]) {
        Ok(metadata) => metadata,
        Err(_) => cargo_metadata(&package, here, &[])
            .map_err(|error| format!("cannot get the published rustdds, see README.md for offline builds:\n{error}"))?,
    };
    let root = package_dir(&metadata).ok_or("cargo metadata does not list the published rustdds")?;
    let mut source = Source::new();
    read_below(&root, &root.join("src"), &mut source)?;
    let found = digest(&source);
    if found != SOURCE_SHA256 {
        return Err(format!(
            "{} is not rustdds 0.15.1 as published (SHA-256 {found}, expected {SOURCE_SHA256}); \
             remove that folder, and cargo unpacks the crate again",
            root.display()
        )
        .into());
    }
    Ok(source)
}

/// Downloads what is missing. The folder `here` decides which configuration cargo reads.
fn cargo_metadata(package: &Path, here: &Path, options: &[&str]) -> Result<String, Box<dyn Error>> {
    let output = Command::new(env::var_os("CARGO").ok_or("CARGO is not set")?)
        .args(["metadata", "--format-version", "1", "--filter-platform", &env::var("TARGET")?])
        .args(options)
        .arg("--manifest-path")
        .arg(package.join("Cargo.toml"))
        .current_dir(here)
        .output()?;
    match output.status.success() {
        true => Ok(String::from_utf8(output.stdout)?),
        false => Err(String::from_utf8_lossy(&output.stderr).into()),
    }
}

/// Returns the folder of the published package. A JSON parser for one string would double the build time.
fn package_dir(metadata: &str) -> Option<PathBuf> {
    let (_, package) = metadata.split_once(&format!("\"id\":\"{PACKAGE_ID}\""))?;
    let (_, path) = package.split_once("\"manifest_path\":\"")?;
    let (path, _) = path.split_once('"')?;
    Some(Path::new(&path.replace("\\\\", "\\")).parent()?.to_owned())
}

fn read_below(root: &Path, folder: &Path, source: &mut Source) -> Result<(), Box<dyn Error>> {
    for path in files_in(folder)? {
        if path.is_dir() {
            read_below(root, &path, source)?;
        } else {
            let name = path.strip_prefix(root)?.to_str().ok_or("a path is not UTF-8")?;
            source.insert(name.replace('\\', "/"), fs::read_to_string(&path)?);
        }
    }
    Ok(())
}

/// Lists files and folders in the order of their names.
fn files_in(folder: &Path) -> Result<Vec<PathBuf>, Box<dyn Error>> {
    let entries = fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let mut paths = entries.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>, std::io::Error>>()?;
    paths.sort();
    Ok(paths)
}

fn digest(source: &Source) -> String {
    let mut hash = Sha256::new();
    for (path, text) in source {
        hash.update(format!("{path}\0{}\0{text}", text.len()));
    }
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Applies one patch. Every line of context has to match.
fn apply(patch: &Path, source: &mut Source) -> Result<(), Box<dyn Error>> {
    let text = fs::read_to_string(patch)?;
    for file in PatchSet::parse(&text, ParseOptions::gitdiff()) {
        let file = file?;
        let change = file.patch().as_text().ok_or("the patch is binary")?;
        match file.operation().strip_prefix(1) {
            FileOperation::Create(path) => {
                if source.insert(path.to_string(), diffy::apply("", change)?).is_some() {
                    return Err(format!("{path} is there already").into());
                }
            }
            FileOperation::Modify { modified: path, .. } => {
                let before = source.get_mut(path.as_ref()).ok_or_else(|| format!("{path} is not there"))?;
                *before = diffy::apply(before, change).map_err(|error| format!("{path}: {error}"))?;
            }
            other => return Err(format!("files are created and modified only, not {other:?}").into()),
        }
    }
    Ok(())
}

/// Takes the documentation and the attributes off the head of the crate root: `include!` accepts none.
fn prepare_for_include(source: &mut Source) -> Result<(), Box<dyn Error>> {
    let root = source.get_mut("src/lib.rs").ok_or("src/lib.rs is not there")?;
    let first_item = root.find("\nmod ").ok_or("src/lib.rs declares no module")?;
    root.drain(..first_item);
    Ok(())
}

fn write(source: &Source, out: &Path) -> Result<(), Box<dyn Error>> {
    if out.join("src").exists() {
        fs::remove_dir_all(out.join("src"))?;
    }
    for (path, text) in source {
        let path = out.join(path);
        fs::create_dir_all(path.parent().unwrap_or(out))?;
        fs::write(path, text)?;
    }
    Ok(())
}
