//! The cache of downloads and compiled files between runs. It is bounded, locked by one run at a
//! time, and emptied after a run that failed.

use std::fs::{self, File};
use std::hash::{DefaultHasher, Hasher as _};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use gdp_tests::programs::{Executable as _, Program};

use crate::shell;

/// A folder of the cache with its size limit and its mount point in the root.
pub struct CachePart {
    name: &'static str,
    /// Maximum size in bytes. A larger folder is emptied before the next run.
    limit: u64,
    pub at: &'static str,
}

const GIB: u64 = 1 << 30;

pub const PARTS: [CachePart; 3] = [
    CachePart { name: "debs", limit: 2 * GIB, at: "var/cache/apt/archives" },
    CachePart { name: "crates", limit: 3 * GIB, at: "root/.cargo/registry" },
    CachePart { name: "wheels", limit: GIB, at: "root/.cache/pip" },
];

/// The folder of debootstrap's downloads.
const DEBOOTSTRAP: &str = "debootstrap";

/// Folders of the clone's target folder with compiled files: one for each profile, and one for each
/// build of the XDP programs. Setup makes the rest of the target folder anew in each run.
pub const COMPILED: [&str; 5] = ["debug", "release", "checked", "bpf", "bpf-rebuilt"];

const COMPILED_LIMIT: u64 = 16 * GIB;

/// The file that shows that the last run left the cache complete.
const COMPLETE: &str = "complete";

pub struct Cache {
    folder: PathBuf,
    /// Whether the root mounts the compiled files of the cache.
    has_compiled: bool,
    /// The lock, held until this is dropped.
    _lock: File,
}

/// The key of compiled files: what they depend on besides the source, which Cargo checks.
pub struct Compiled {
    key: String,
}

impl Compiled {
    /// Computes the key from the compiler and the table of setup steps. Otherwise an executable
    /// compiled under an earlier table could hide that it no longer compiles.
    pub fn key(clone: &Path) -> Result<Self> {
        let steps = clone.join("xtask/src/setup/steps.rs");
        let steps = fs::read(&steps).with_context(|| format!("cannot read {}", steps.display()))?;
        let compiler = shell::output(Program::Rustc.command().arg("-vV")).context("rustc does not tell its version")?;
        let mut hasher = DefaultHasher::new();
        hasher.write(&steps);
        hasher.write(compiler.as_bytes());
        Ok(Self { key: format!("{:016x}", hasher.finish()) })
    }
}

impl Cache {
    /// Opens and locks the cache, and waits for another run. Empties folders that are too large,
    /// and all folders if the last run did not complete.
    pub fn open(folder: &Path) -> Result<Self> {
        fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
        let lock = folder.join("lock");
        let lock = File::create(&lock).with_context(|| format!("cannot create {}", lock.display()))?;
        if lock.try_lock().is_err() {
            eprintln!("waiting for another `cargo xtask fresh`");
            lock.lock().context("cannot lock the cache")?;
        }
        let this = Self { folder: folder.to_owned(), has_compiled: false, _lock: lock };
        let is_complete = this.folder.join(COMPLETE).is_file();
        if is_complete {
            remove(&this.folder.join(COMPLETE))?;
        }
        let limits = PARTS.iter().map(|part| (part.name, part.limit));
        for (name, limit) in limits.chain([(DEBOOTSTRAP, GIB), ("compiled", COMPILED_LIMIT)]) {
            let part = this.folder.join(name);
            if !is_complete || size(&part)? > limit {
                remove(&part)?;
            }
            fs::create_dir_all(&part).with_context(|| format!("cannot create {}", part.display()))?;
        }
        Ok(this)
    }

    /// Marks the cache as complete for the next run.
    pub fn complete(&self) -> Result<()> {
        let marker = self.folder.join(COMPLETE);
        fs::write(&marker, "").with_context(|| format!("cannot write {}", marker.display()))
    }

    /// Mounts the compiled files of the cache from now on. Removes them first if they have another
    /// key.
    pub fn use_compiled(&mut self, compiled: &Compiled) -> Result<()> {
        let key = self.compiled().join("key");
        if fs::read_to_string(&key).ok().as_deref() != Some(&compiled.key) {
            remove(&self.compiled())?;
        }
        for name in COMPILED {
            let folder = self.compiled().join(name);
            fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
        }
        fs::write(&key, &compiled.key).with_context(|| format!("cannot write {}", key.display()))?;
        self.has_compiled = true;
        Ok(())
    }

    /// Returns the file that records when each content of the clone was first seen.
    pub fn times(&self) -> PathBuf {
        self.compiled().join("times")
    }

    pub fn debootstrap(&self) -> PathBuf {
        self.folder.join(DEBOOTSTRAP)
    }

    /// Returns the folder in which roots are made.
    pub fn roots(&self) -> PathBuf {
        self.folder.clone()
    }

    /// Returns the folders of the cache with their mount points in the root. `clone` is the path of
    /// the tree in the root.
    pub fn mounts(&self, clone: &str) -> Vec<(PathBuf, String)> {
        let parts = PARTS.iter().map(|part| (self.folder.join(part.name), part.at.to_owned()));
        let compiled = COMPILED.iter().filter(|_| self.has_compiled);
        let compiled = compiled.map(|name| (self.compiled().join(name), format!("{clone}/target/{name}")));
        parts.chain(compiled).collect()
    }

    fn compiled(&self) -> PathBuf {
        self.folder.join("compiled")
    }
}

/// Returns the size of all files below `path` in bytes. Ignores files that vanish meanwhile.
fn size(path: &Path) -> Result<u64> {
    let Ok(metadata) = fs::symlink_metadata(path) else { return Ok(0) };
    if !metadata.is_dir() {
        return Ok(metadata.len());
    }
    let entries = fs::read_dir(path).with_context(|| format!("cannot read {}", path.display()))?;
    entries.flatten().map(|entry| size(&entry.path())).sum()
}

/// Removes a file or folder, if it exists.
fn remove(path: &Path) -> Result<()> {
    let removed = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
    match removed {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(error).with_context(|| format!("cannot remove {}", path.display()))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
#[path = "../../tests/unit/fresh/cache.rs"]
mod tests;
