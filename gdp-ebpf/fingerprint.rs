//! A hash over everything that the XDP programs are compiled from.
//!
//! `xtask`, which compiles the programs, and the build script that embeds them include this file.
//! The build script therefore never embeds an object that was compiled from other source.

use std::collections::BTreeSet;
use std::hash::{DefaultHasher, Hasher as _};
use std::path::{Path, PathBuf};
use std::{fs, io};

/// Files and folders, relative to the root of the workspace.
pub const SOURCES: [&str; 5] =
    ["gdp-ebpf/Cargo.toml", "gdp-ebpf/Cargo.lock", "gdp-ebpf/src", "crates/gdp-wire/Cargo.toml", "crates/gdp-wire/src"];

/// The folder of the object, relative to the root of the workspace. It contains nothing else.
pub const FOLDER: &str = "gdp-ebpf/object";

/// Returns the files of [`SOURCES`], sorted. `root` is the root of the workspace.
pub fn files(root: &Path) -> io::Result<BTreeSet<PathBuf>> {
    let mut files = BTreeSet::new();
    SOURCES.iter().try_for_each(|source| collect(&root.join(source), &mut files))?;
    Ok(files)
}

/// Returns the path that the object of the present source has once it is compiled.
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
