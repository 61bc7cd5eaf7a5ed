//! Compiles the foreign programs (sources in `tests/peers`). Only those of Fast DDS and roscpp need
//! it; the others are Python.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::SystemTime;

use anyhow::{Context, Result};
use gdp_tests::programs::{Executable as _, Program};

use crate::setup::GENCPP;
use crate::shell;
use crate::workspace::{self, Profile};

/// Compiles the peers to `target/peers` if their sources are newer.
pub fn build() -> Result<()> {
    build_dds()?;
    build_actionlib()?;
    build_roscpp()
}

/// Compiles the Fast DDS peers.
pub fn build_dds() -> Result<()> {
    compile("fastdds-peer", Some("String"), "fastdds.cpp")?;
    compile("fastdds-service-peer", Some("AddTwoInts"), "fastdds_service.cpp")?;
    compile("fastdds-any", None, "any/fastdds_any.cpp")
}

/// Libraries of roscpp and actionlib, as pkg-config names them.
const ROSCPP: [&str; 8] = [
    "-lactionlib",
    "-lroscpp",
    "-lrosconsole",
    "-lroscpp_serialization",
    "-lrostime",
    "-lcpp_common",
    "-lboost_thread",
    "-lboost_system",
];

/// Compiles the peer of roscpp and actionlib, with generated headers for its action.
fn build_actionlib() -> Result<()> {
    const PACKAGE: &str = "test_msgs";
    let (sources, out) = (workspace::root().join("tests/peers"), workspace::target().join("peers"));
    let (source, action, program) =
        (sources.join("actionlib.cpp"), sources.join("Fibonacci.action"), out.join("actionlib-peer"));
    if is_newer(&program, &[&source, &action]) {
        return Ok(());
    }
    let (messages, include) = (out.join("actionlib/msg"), out.join("actionlib/include"));
    std::fs::create_dir_all(&messages).with_context(|| format!("cannot create {}", messages.display()))?;
    shell::say_and_run(python("/usr/lib/actionlib_msgs/genaction.py").arg(&action).arg("-o").arg(&messages))?;
    for part in ["Action", "ActionGoal", "ActionResult", "ActionFeedback", "Goal", "Result", "Feedback"] {
        let mut generator = python(GENCPP);
        generator.arg(messages.join(format!("Fibonacci{part}.msg"))).args(["-p", PACKAGE, "-e", "/usr/share/gencpp"]);
        generator.arg("-o").arg(include.join(PACKAGE)).arg("-I").arg(format!("{PACKAGE}:{}", messages.display()));
        for package in ["std_msgs", "actionlib_msgs"] {
            generator.arg("-I").arg(format!("{package}:/usr/share/{package}/msg"));
        }
        shell::say_and_run(&mut generator)?;
    }
    compile_roscpp(&include, &source, &program)
}

/// Compiles the peer of roscpp alone, with generated headers for its service.
fn build_roscpp() -> Result<()> {
    let out = workspace::target().join("peers");
    let (source, program) = (workspace::root().join("tests/peers/roscpp.cpp"), out.join("roscpp-peer"));
    if is_newer(&program, &[&source]) {
        return Ok(());
    }
    let include = out.join("roscpp/include");
    let mut generator = python(GENCPP);
    generator.args(["/usr/share/std_srvs/srv/SetBool.srv", "-p", "std_srvs", "-e", "/usr/share/gencpp", "-o"]);
    shell::say_and_run(generator.arg(include.join("std_srvs")))?;
    compile_roscpp(&include, &source, &program)
}

fn compile_roscpp(include: &Path, source: &Path, program: &Path) -> Result<()> {
    let partial = program.with_extension("new");
    let mut compiler = Program::Cxx.command();
    compiler.args(["-std=c++17", "-O1", "-Wall", "-Wno-deprecated-declarations", "-I"]).arg(include);
    compiler.arg("-o").arg(&partial).arg(source);
    shell::say_and_run(compiler.args(ROSCPP))?;
    std::fs::rename(&partial, program).with_context(|| format!("cannot rename {}", partial.display()))
}

fn python(script: &str) -> Command {
    let mut command = Program::Python3.command();
    command.arg(script);
    command
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

/// Compiles the QUIC peer, with the executables' profile.
pub fn build_quic(profile: Profile) -> Result<()> {
    let mut command = shell::cargo();
    command.args(["build", "--profile", profile.name(), "--package", "gdp-tests", "--example", "quic-peer"]);
    shell::say_and_run(&mut command)
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
