//! What one run downloads and compiles for the next: bounded, for one run at a time, and emptied
//! when a run ends badly.

use std::fs::{self, File};
use std::hash::{DefaultHasher, Hasher as _};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use gdp_tests::programs::{Executable as _, Program};

use crate::shell;

/// A folder of the cache, what it may hold, and where it is in the root.
pub struct CachePart {
    name: &'static str,
    /// Bytes. A larger folder is emptied before the next run.
    limit: u64,
    pub at: &'static str,
}

const GIB: u64 = 1 << 30;

pub const PARTS: [CachePart; 3] = [
    CachePart { name: "debs", limit: 2 * GIB, at: "var/cache/apt/archives" },
    CachePart { name: "crates", limit: 3 * GIB, at: "root/.cargo/registry" },
    CachePart { name: "wheels", limit: GIB, at: "root/.cache/pip" },
];

/// What debootstrap downloads.
const DEBOOTSTRAP: &str = "debootstrap";

/// What Cargo compiles: folders of the clone's target folder, one for each profile and one for each
/// build of the XDP programs. The rest of the target folder is setup's, and made anew in each run.
pub const COMPILED: [&str; 5] = ["debug", "release", "checked", "bpf", "bpf-rebuilt"];

const COMPILED_LIMIT: u64 = 16 * GIB;

/// Shows that the last run that used the cache left it in order.
const COMPLETE: &str = "complete";

pub struct Cache {
    folder: PathBuf,
    /// Whether what is compiled is taken from the cache.
    has_compiled: bool,
    /// Locked as long as this lives.
    _lock: File,
}

/// What compiled files depend on beside the source, which Cargo looks at.
pub struct Compiled {
    key: String,
}

impl Compiled {
    /// The compiler, and the table of what setup installs: an executable that was compiled when
    /// setup installed more must not hide that it cannot be compiled any more.
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
    /// Waits for another run. Removes what a run left that did not come to its end, and what is too
    /// large.
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

    /// What it holds is good, for the next run.
    pub fn complete(&self) -> Result<()> {
        let marker = self.folder.join(COMPLETE);
        fs::write(&marker, "").with_context(|| format!("cannot write {}", marker.display()))
    }

    /// From now on compiled files are taken from the cache, unless they were compiled under other
    /// conditions.
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

    /// When the content of each file of the clone was first seen.
    pub fn times(&self) -> PathBuf {
        self.compiled().join("times")
    }

    pub fn debootstrap(&self) -> PathBuf {
        self.folder.join(DEBOOTSTRAP)
    }

    /// The folder that roots are made in.
    pub fn roots(&self) -> PathBuf {
        self.folder.clone()
    }

    /// Folders of the cache, and where they are mounted in the root. `clone`: where the tree is
    /// there.
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

/// Bytes of the files below `path`, those that vanish meanwhile left out.
fn size(path: &Path) -> Result<u64> {
    let Ok(metadata) = fs::symlink_metadata(path) else { return Ok(0) };
    if !metadata.is_dir() {
        return Ok(metadata.len());
    }
    let entries = fs::read_dir(path).with_context(|| format!("cannot read {}", path.display()))?;
    entries.flatten().map(|entry| size(&entry.path())).sum()
}

/// Removes a file or folder, which may not be there.
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
