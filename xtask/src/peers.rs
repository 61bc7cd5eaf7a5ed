//! The foreign DDS programs (sources in `tests/peers`): Fast DDS is compiled here, Cyclone DDS is Python.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::SystemTime;

use anyhow::{Context, Result};

use crate::{shell, workspace};

/// Compiles the Fast DDS peers to `target/peers`, where a source is newer.
pub fn build() -> Result<()> {
    compile("fastdds-peer", "String", "fastdds.cpp")?;
    compile("fastdds-service-peer", "AddTwoInts", "fastdds_service.cpp")
}

fn compile(name: &str, interface: &str, source: &str) -> Result<()> {
    let sources = workspace::root().join("tests/peers");
    let out = workspace::target().join("peers");
    let program = out.join(name);
    let inputs = [sources.join(format!("{interface}.idl")), sources.join(source)];
    if is_newer(&program, &inputs) {
        return Ok(());
    }
    std::fs::create_dir_all(&out).with_context(|| format!("cannot create {}", out.display()))?;
    shell::say_and_run(
        Command::new("fastddsgen").arg("-replace").arg("-d").arg(&out).arg(&inputs[0]).current_dir(&out),
    )?;
    // Linked under another name and renamed, so that a failed build leaves nothing that looks current.
    let partial = out.join(format!("{name}.new"));
    shell::say_and_run(
        Command::new("c++")
            .args(["-std=c++17", "-O1", "-Wall", "-Wno-deprecated-declarations", "-I"])
            .arg(&out)
            .arg("-o")
            .arg(&partial)
            .arg(&inputs[1])
            .args([out.join(format!("{interface}.cxx")), out.join(format!("{interface}PubSubTypes.cxx"))])
            .args(["-lfastrtps", "-lfastcdr", "-lpthread"]),
    )?;
    std::fs::rename(&partial, &program).with_context(|| format!("cannot rename {}", partial.display()))
}

fn is_newer(product: &Path, sources: &[PathBuf]) -> bool {
    let time = |path: &Path| -> Option<SystemTime> { std::fs::metadata(path).ok()?.modified().ok() };
    let Some(built) = time(product) else { return false };
    sources.iter().all(|source| time(source).is_some_and(|changed| changed < built))
}
