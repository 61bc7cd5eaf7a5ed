//! Lays out the files of each package.

use std::fs::{self, File, Permissions};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, UNIX_EPOCH};

use anyhow::{Context, Result, ensure};
use gdp_tests::netns::execute;
use gdp_tests::programs::{Executable as _, Program};

use super::arch::Arch;
use super::build::{Build, packaging};
use super::compile::{self, Executables};
use super::{changelog, manuals, sbom};
use crate::{git, workspace};

/// A package, with the files that it installs.
pub struct Staged {
    pub arch: Arch,
    pub version: String,
    pub is_checked: bool,
    /// Where the packages belong.
    pub folder: PathBuf,
    /// The glibc that the executables need.
    pub glibc: (u32, u32),
    pub packages: Vec<Package>,
    /// The time of every file, in seconds since 1970.
    pub epoch: u64,
}

/// The files of one package.
pub struct Package {
    pub name: &'static str,
    pub tree: PathBuf,
}

const SWITCH_UNITS: [&str; 2] = ["gdp-switch.service", "gdp-join.service"];
const PROXY_UNITS: [&str; 2] = ["gdp-proxy.service", "gdp-proxy@.service"];

/// Compiles, and lays out the files of all packages.
pub fn staged(build: &Build) -> Result<Staged> {
    lay_out(build, &compile::executables(build)?, build.folder())
}

/// Lays out the files of all packages in a folder.
pub fn lay_out(build: &Build, executables: &Executables, folder: PathBuf) -> Result<Staged> {
    let above = folder.join(build.arch.debian());
    if above.exists() {
        fs::remove_dir_all(&above).with_context(|| format!("cannot remove {}", above.display()))?;
    }
    let mut packages = Vec::new();
    for name in ["gdp-cli", "gdp-switch", "gdp-proxy"] {
        let tree = above.join(name);
        let documents = tree.join("usr/share/doc").join(name);
        fs::create_dir_all(&documents)?;
        fs::copy(packaging("debian/copyright"), documents.join("copyright"))?;
        changelog::write(&build.version, &documents.join("changelog.Debian"))?;
        execute(Program::Gzip.command().arg("-9n").arg(documents.join("changelog.Debian")))?;
        packages.push(Package { name, tree });
    }
    let [cli, switch, proxy] = [0, 1, 2].map(|at: usize| packages[at].tree.clone());
    executable(&executables.ctl, &cli.join("usr/bin/gdp-ctl"), build)?;
    executable(&executables.proxy, &proxy.join("usr/bin/gdp-proxy"), build)?;
    // The other architecture's pages are the same.
    manuals::write("gdp-ctl", &runnable("gdp-ctl", &executables.ctl, build)?, &cli)?;
    manuals::write("gdp-proxy", &runnable("gdp-proxy", &executables.proxy, build)?, &proxy)?;
    sbom::write("gdp-ctl", build, &cli.join("usr/share/doc/gdp-cli"))?;
    sbom::write("gdp-proxy", build, &proxy.join("usr/share/doc/gdp-proxy"))?;
    copy_all(&SWITCH_UNITS, "systemd", &switch.join("usr/lib/systemd/system"))?;
    copy_all(&PROXY_UNITS, "systemd", &proxy.join("usr/lib/systemd/system"))?;
    copy_all(&["gdp.conf"], "sysusers.d", &cli.join("usr/lib/sysusers.d"))?;
    copy_all(&["gdp-switch.conf"], "tmpfiles.d", &switch.join("usr/lib/tmpfiles.d"))?;
    copy_all(&["gdp-switch", "gdp-join"], "default", &switch.join("etc/default"))?;
    copy_all(&["gdp-proxy"], "default", &proxy.join("etc/default"))?;
    let (version, glibc) = (build.version.clone(), executables.glibc);
    let epoch = epoch()?;
    packages.iter().try_for_each(|package| settle(&package.tree, epoch))?;
    Ok(Staged { arch: build.arch, version, is_checked: build.checked, folder, glibc, packages, epoch })
}

/// Returns the time for files of packages: `SOURCE_DATE_EPOCH`, or that of the commit.
/// <https://reproducible-builds.org/docs/source-date-epoch/>
fn epoch() -> Result<u64> {
    match std::env::var("SOURCE_DATE_EPOCH") {
        Ok(text) => text.parse().with_context(|| format!("SOURCE_DATE_EPOCH={text} is no number of seconds")),
        Err(_) => git::commit_time().context("set SOURCE_DATE_EPOCH to the time of the source"),
    }
}

/// Gives files and folders the modes that Debian expects, whatever the umask was, and one time.
pub fn settle(tree: &Path, epoch: u64) -> Result<()> {
    walk(tree, &mut |path, metadata| {
        let is_executable = metadata.is_dir() || metadata.permissions().mode() & 0o100 != 0;
        fs::set_permissions(path, Permissions::from_mode(if is_executable { 0o755 } else { 0o644 }))?;
        Ok(File::open(path)?.set_modified(UNIX_EPOCH + Duration::from_secs(epoch))?)
    })
}

/// Visits what is below a path: first the files of a folder, then the folder.
pub fn walk(path: &Path, visit: &mut impl FnMut(&Path, &fs::Metadata) -> Result<()>) -> Result<()> {
    let metadata = path.symlink_metadata().with_context(|| format!("cannot read {}", path.display()))?;
    ensure!(!metadata.is_symlink(), "{} is a symbolic link, which a package needs no", path.display());
    if metadata.is_dir() {
        for entry in fs::read_dir(path)? {
            walk(&entry?.path(), visit)?;
        }
    }
    visit(path, &metadata)
}

fn copy_all(names: &[&str], from: &str, to: &Path) -> Result<()> {
    fs::create_dir_all(to)?;
    names.iter().try_for_each(|name| {
        let source = packaging(from).join(name);
        fs::copy(&source, to.join(name)).with_context(|| format!("cannot copy {}", source.display()))?;
        Ok(fs::set_permissions(to.join(name), Permissions::from_mode(0o644))?)
    })
}

/// Copies an executable without its symbols.
fn executable(from: &Path, to: &Path, build: &Build) -> Result<()> {
    fs::create_dir_all(to.parent().context("a folder")?)?;
    fs::copy(from, to).with_context(|| format!("cannot copy {}", from.display()))?;
    fs::set_permissions(to, Permissions::from_mode(0o755))?;
    let objcopy = if build.arch.is_native() { Program::Objcopy } else { Program::ObjcopyArm64 };
    execute(objcopy.command().arg("--strip-all").arg(to))?;
    Ok(())
}

/// Returns an executable of the same source that this machine runs.
fn runnable(name: &str, built: &Path, build: &Build) -> Result<PathBuf> {
    if build.arch.is_native() {
        return Ok(built.to_owned());
    }
    let target = workspace::target();
    let folders = [target.join("x86_64-unknown-linux-gnu/dist"), target.join("x86_64-unknown-linux-gnu/release")];
    let all = folders.into_iter().chain(["dist", "release", "checked"].map(|profile| target.join(profile)));
    let newest = all.map(|folder| folder.join(name)).filter(|file| file.is_file());
    newest
        .max_by_key(|file| file.metadata().and_then(|metadata| metadata.modified()).ok())
        .with_context(|| format!("no {name} for this machine writes the manual pages: make its own packages first"))
}
