//! A hash over everything that the XDP programs are compiled from.
//!
//! `xtask`, which compiles them, and the build script that embeds them include this file: an object
//! that was made from other source is never embedded.

use std::collections::BTreeSet;
use std::hash::{DefaultHasher, Hasher as _};
use std::path::{Path, PathBuf};
use std::{fs, io};

/// Files and folders below the root of the workspace.
pub const SOURCES: [&str; 5] =
    ["gdp-ebpf/Cargo.toml", "gdp-ebpf/Cargo.lock", "gdp-ebpf/src", "crates/gdp-wire/Cargo.toml", "crates/gdp-wire/src"];

/// The folder below the root of the workspace that holds the object, and nothing else.
pub const FOLDER: &str = "gdp-ebpf/object";

/// The files below [`SOURCES`], in order. `root`: the workspace's.
pub fn files(root: &Path) -> io::Result<BTreeSet<PathBuf>> {
    let mut files = BTreeSet::new();
    SOURCES.iter().try_for_each(|source| collect(&root.join(source), &mut files))?;
    Ok(files)
}

/// Where the object of the present source is, once it is compiled.
pub fn object(root: &Path) -> io::Result<PathBuf> {
    let mut hasher = DefaultHasher::new();
    for file in files(root)? {
        let bytes = fs::read(&file).map_err(|error| named(&file, error))?;
        hasher.write(file.strip_prefix(root).unwrap_or(&file).as_os_str().as_encoded_bytes());
        hasher.write_usize(bytes.len());
        hasher.write(&bytes);
    }
    Ok(root.join(FOLDER).join(format!("{:016x}.o", hasher.finish())))
}

fn collect(path: &Path, files: &mut BTreeSet<PathBuf>) -> io::Result<()> {
    if !path.is_dir() {
        files.insert(path.to_owned());
        return Ok(());
    }
    for entry in fs::read_dir(path).map_err(|error| named(path, error))? {
        collect(&entry?.path(), files)?;
    }
    Ok(())
}

fn named(path: &Path, error: io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("{}: {error}", path.display()))
}
