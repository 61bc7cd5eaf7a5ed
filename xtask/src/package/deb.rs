//! Writes Debian packages with `dpkg-deb`, and checks them with lintian.

use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use gdp_tests::netns::execute;
use gdp_tests::programs::{Executable as _, Program};

use super::build::packaging;
use super::changelog::MAINTAINER;
use super::stage::{Package, Staged, settle, walk};
use crate::shell;

const SCRIPTS: [&str; 4] = ["preinst", "postinst", "prerm", "postrm"];

/// Writes one file for each package, and returns their paths.
pub fn write(staged: &Staged) -> Result<Vec<PathBuf>> {
    let control = packaging("debian/control");
    let control = fs::read_to_string(&control).with_context(|| format!("cannot read {}", control.display()))?;
    staged.packages.iter().map(|package| write_one(staged, package, &control)).collect()
}

fn write_one(staged: &Staged, package: &Package, control: &str) -> Result<PathBuf> {
    let (arch, version) = (staged.arch.debian(), format!("{}-1", staged.version));
    let control_folder = package.tree.join("DEBIAN");
    fs::create_dir_all(&control_folder)?;
    let head = format!("Package: {}\n", package.name);
    let stanza = control.split("\n\n").find(|stanza| stanza.starts_with(&head));
    let stanza = stanza.with_context(|| format!("packaging/debian/control has no {}", package.name))?;
    let (name, rest) = stanza.trim_end().split_once('\n').context("a stanza has lines")?;
    let fields = format!(
        "{name}\nSource: gdp\nVersion: {version}\nArchitecture: {arch}\nMaintainer: {MAINTAINER}\nPriority: optional\n\
         Installed-Size: {}\n{}\n",
        size(&package.tree)?,
        rest.replace("VERSION", &version).replace("GLIBC", &format!("{}.{}", staged.glibc.0, staged.glibc.1))
    );
    fs::write(control_folder.join("control"), fields)?;
    for script in SCRIPTS {
        let source = packaging("debian").join(format!("{}.{script}", package.name));
        if source.is_file() {
            fs::copy(&source, control_folder.join(script))?;
            fs::set_permissions(control_folder.join(script), Permissions::from_mode(0o755))?;
        }
    }
    let overrides = packaging("debian").join(format!("{}.lintian-overrides", package.name));
    if overrides.is_file() {
        let to = package.tree.join("usr/share/lintian/overrides");
        fs::create_dir_all(&to)?;
        fs::copy(&overrides, to.join(package.name))?;
    }
    let files = files(&package.tree)?;
    let settings: String =
        files.iter().filter(|file| file.starts_with("etc/")).map(|file| format!("/{file}\n")).collect();
    if !settings.is_empty() {
        fs::write(control_folder.join("conffiles"), settings)?;
    }
    let installed = files.iter().filter(|file| !file.starts_with("DEBIAN/") && !file.starts_with("etc/"));
    let mut sums = Program::Md5sum.command();
    sums.args(installed).current_dir(&package.tree);
    fs::write(control_folder.join("md5sums"), execute(&mut sums)? + "\n")?;
    settle(&package.tree, staged.epoch)?;
    let deb = staged.folder.join(format!("{}_{version}_{arch}.deb", package.name));
    let mut dpkg = Program::DpkgDeb.command();
    dpkg.arg("--root-owner-group").args(if staged.is_checked { ["-Zgzip", "-z1"] } else { ["-Zxz", "-z6"] });
    // dpkg-deb sorts what it packs. It takes this for the times of its own members.
    dpkg.env("SOURCE_DATE_EPOCH", staged.epoch.to_string()).arg("--build");
    execute(dpkg.arg(&package.tree).arg(&deb))?;
    println!("{} ({:.1} MB)", deb.display(), deb.metadata()?.len() as f64 / 1e6);
    Ok(deb)
}

/// Fails if lintian finds an error, or a warning that no override explains.
pub fn check(debs: &[PathBuf]) -> Result<()> {
    let mut lintian = Program::Lintian.command();
    lintian.args(["--allow-root", "--fail-on", "error,warning", "--tag-display-limit", "0"]).args(debs);
    shell::say_and_run(&mut lintian)
}

/// Returns the files of a tree, relative to it, in order.
pub fn files(tree: &Path) -> Result<Vec<String>> {
    let mut all = Vec::new();
    walk(tree, &mut |path, metadata| {
        if !metadata.is_dir() {
            all.push(path.strip_prefix(tree)?.to_string_lossy().into_owned());
        }
        Ok(())
    })?;
    all.sort();
    Ok(all)
}

/// Returns the size that files take, in KiB: each in whole ones. Folders differ by file system.
fn size(tree: &Path) -> Result<u64> {
    let mut sum = 0;
    walk(tree, &mut |_, metadata| {
        sum += if metadata.is_dir() { 0 } else { metadata.len().div_ceil(1024) };
        Ok(())
    })?;
    Ok(sum)
}

#[cfg(test)]
#[path = "../../tests/unit/package/deb.rs"]
mod tests;
