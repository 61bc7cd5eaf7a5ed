//! Compiles the foreign DDS programs (sources in `tests/peers`). Only those of Fast DDS need it;
//! Cyclone DDS is Python.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use anyhow::{Context, Result};
use gdp_tests::programs::{Executable as _, Program};

use crate::{shell, workspace};

/// Compiles the Fast DDS peers to `target/peers` if their sources are newer.
pub fn build() -> Result<()> {
    compile("fastdds-peer", Some("String"), "fastdds.cpp")?;
    compile("fastdds-service-peer", Some("AddTwoInts"), "fastdds_service.cpp")?;
    compile("fastdds-any", None, "any/fastdds_any.cpp")
}

/// Compiles the zenoh bridge, which has its own workspace, and returns its path.
pub fn build_zenoh() -> Result<PathBuf> {
    let (manifest, out) =
        (workspace::root().join("tests/peers/zenoh-bridge/Cargo.toml"), workspace::target().join("zenoh"));
    let mut command = shell::cargo();
    command.args(["build", "--release", "--locked", "--manifest-path"]).arg(manifest).arg("--target-dir").arg(&out);
    shell::say_and_run(&mut command)?;
    Ok(out.join("release/zenoh-bridge"))
}

/// Compiles one peer. `interface` is the IDL file to generate code from.
fn compile(name: &str, interface: Option<&str>, source: &str) -> Result<()> {
    let sources = workspace::root().join("tests/peers");
    let out = workspace::target().join("peers");
    let program = out.join(name);
    let source = sources.join(source);
    let interface = interface.map(|interface| (interface, sources.join(format!("{interface}.idl"))));
    let inputs: Vec<&Path> = interface.iter().map(|(_, idl)| idl.as_path()).chain([source.as_path()]).collect();
    if is_newer(&program, &inputs) {
        return Ok(());
    }
    std::fs::create_dir_all(&out).with_context(|| format!("cannot create {}", out.display()))?;
    // Linked under another name and renamed, so that a failed build does not leave a file that
    // looks current.
    let partial = out.join(format!("{name}.new"));
    let mut compiler = Program::Cxx.command();
    compiler.args(["-std=c++17", "-O1", "-Wall", "-Wno-deprecated-declarations", "-I"]).arg(&out);
    compiler.arg("-o").arg(&partial).arg(&source);
    if let Some((interface, idl)) = &interface {
        let mut generator = Program::Fastddsgen.command();
        shell::say_and_run(generator.arg("-replace").arg("-d").arg(&out).arg(idl).current_dir(&out))?;
        compiler.args([out.join(format!("{interface}.cxx")), out.join(format!("{interface}PubSubTypes.cxx"))]);
    }
    shell::say_and_run(compiler.args(["-lfastrtps", "-lfastcdr", "-lpthread"]))?;
    std::fs::rename(&partial, &program).with_context(|| format!("cannot rename {}", partial.display()))
}

fn is_newer(product: &Path, sources: &[&Path]) -> bool {
    let time = |path: &Path| -> Option<SystemTime> { std::fs::metadata(path).ok()?.modified().ok() };
    let Some(built) = time(product) else { return false };
    sources.iter().all(|source| time(source).is_some_and(|changed| changed < built))
}
