//! `cargo xtask fuzz TARGET`: runs libFuzzer with coverage feedback, on the compiler that builds
//! everything else.
//!
//! The instrumentation is LLVM's and needs no nightly flags. Only the address sanitizer would need
//! them, and the targets are safe Rust except for a few lines. Inputs that the fuzzer finds stay in
//! the target folder. After a crash the verb names the input, which should become a case in
//! `fuzz/corpus`.

use anyhow::{Context, Result};
use gdp_tests::programs::{Executable as _, Program, own};

use crate::setup::{self, Purpose};
use crate::{shell, workspace};

#[derive(clap::Args)]
pub struct Options {
    /// Executable of `fuzz` to run
    #[arg(value_parser = ["decide", "control", "cert", "feedback", "key_box", "segments", "msg", "call", "xmlrpc", "ros1_header"])]
    target: String,
    /// Duration in seconds
    #[arg(long, default_value_t = 60)]
    seconds: u32,
}

/// Counters at each edge of the control flow, and traces of the operands of comparisons.
const COVERAGE: &str = "-Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
                        -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
                        -Cllvm-args=-sanitizer-coverage-trace-compares -Ccodegen-units=1";

pub fn run(options: Options) -> Result<()> {
    setup::ensure(Purpose::Run)?;
    let Options { target, seconds } = options;
    let folder = workspace::target().join("fuzz");
    let host = host()?;
    // `--target` keeps build scripts from being instrumented, because they do not link the fuzzing
    // engine.
    let mut build = shell::cargo();
    build.args(["build", "-p", "gdp-fuzz", "--features", "libfuzzer", "--bin", &target, "--profile", "checked"]);
    build.args(["--target", &host, "--target-dir"]).arg(&folder).env("RUSTFLAGS", COVERAGE);
    shell::run(&mut build)?;

    let [found, seeds, crashes] = ["found", "seeds", "crashes"].map(|kind| folder.join(kind).join(&target));
    for folder in [&found, &seeds, &crashes] {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    }
    let mut fuzzer = own(folder.join(host).join("checked").join(&target));
    fuzzer.arg(format!("-max_total_time={seconds}")).args(["-max_len=4096", "-timeout=5", "-rss_limit_mb=2048"]);
    fuzzer.arg(format!("-artifact_prefix={}/", crashes.display()));
    // The executable writes the seeds itself before it reads them.
    fuzzer.env("GDP_FUZZ_SEEDS", &seeds);
    shell::say_and_run(fuzzer.arg(found).arg(seeds).arg(workspace::root().join("fuzz/corpus").join(&target)))
        .with_context(|| {
            format!(
                "what made it fail is in {}: copy it to fuzz/corpus/{target} under a name that says what it shows",
                crashes.display()
            )
        })
}

/// Returns the default platform of this compiler.
fn host() -> Result<String> {
    let version = shell::output(Program::Rustc.command().arg("-vV")).context("rustc does not say its version")?;
    let host = version.lines().find_map(|line| line.strip_prefix("host: ")).context("rustc does not say its host")?;
    Ok(host.to_owned())
}
