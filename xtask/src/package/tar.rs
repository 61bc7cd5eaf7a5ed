//! Writes all files of the packages into one tar, for distributions without Debian packages.

use std::fs;
use std::path::PathBuf;

use anyhow::Result;
use gdp_tests::netns::execute;
use gdp_tests::programs::{Executable as _, Program};

use super::build::packaging;
use super::stage::{Staged, settle};

pub fn write(staged: &Staged) -> Result<PathBuf> {
    let name = format!("gdp-{}-{}", staged.version, staged.arch.debian());
    let tree = staged.folder.join(&name);
    if tree.exists() {
        fs::remove_dir_all(&tree)?;
    }
    fs::create_dir_all(&tree)?;
    for package in &staged.packages {
        for part in ["usr", "etc"] {
            if package.tree.join(part).exists() {
                execute(Program::Cp.command().arg("-r").arg(package.tree.join(part)).arg(&tree))?;
            }
        }
    }
    // A script of gdp-cli makes this folder, only where there is none.
    fs::copy(packaging("tmpfiles.d/gdp.conf"), tree.join("usr/lib/tmpfiles.d/gdp.conf"))?;
    // What only dpkg reads.
    let _ = fs::remove_dir_all(tree.join("usr/share/lintian"));
    fs::copy(packaging("INSTALL"), tree.join("INSTALL"))?;
    // A tar would replace the administrator's files.
    for file in ["gdp-switch", "gdp-join", "gdp-proxy"] {
        let path = tree.join("etc/default").join(file);
        fs::rename(&path, path.with_extension("example"))?;
    }
    settle(&tree, staged.epoch)?;
    let file = staged.folder.join(format!("{name}.tar.xz"));
    let mut tar = Program::Tar.command();
    tar.args(["--sort=name", "--owner=0", "--group=0", "--numeric-owner", "-cJf"]).arg(&file);
    execute(tar.current_dir(&staged.folder).arg(&name))?;
    fs::remove_dir_all(&tree)?;
    println!("{} ({:.1} MB)", file.display(), file.metadata()?.len() as f64 / 1e6);
    Ok(file)
}
