//! `cargo xtask setup [PURPOSE…]`: installs what this machine lacks, and prints what and why first.
//!
//! The table [`steps::STEPS`] is complete: a new requirement needs only a new step there. Other
//! verbs call [`ensure`] with their purpose. If nothing is missing, that looks up a few files and
//! prints nothing.

mod ebpf;
mod paths;
mod purpose;
mod step;
mod steps;

pub use crate::setup::purpose::Purpose;
use std::collections::BTreeSet;

use anyhow::{Result, bail, ensure};
use clap::ValueEnum;
use gdp_tests::programs::{Executable as _, Program};

pub use self::ebpf::{EbpfCompiler, bpf_linker};
pub use self::paths::installed_by_cargo;
use self::step::SetupStep;
use self::steps::STEPS;
pub use self::steps::{DENY_ENVIRONMENT, EVAL_ENVIRONMENT, GENCPP, ZIG_ENVIRONMENT};
use crate::{shell, workspace};

#[derive(clap::Args)]
pub struct Options {
    /// Purposes of this machine. Default: all
    #[arg(value_enum)]
    purposes: Vec<Purpose>,
    /// Print the missing items and their install commands, and install nothing
    #[arg(long)]
    dry_run: bool,
    /// Look up every external program that tests, benchmarks and `xtask` start, and install nothing
    #[arg(long, conflicts_with_all = ["purposes", "dry_run"])]
    programs: bool,
}

pub fn run(options: Options) -> Result<()> {
    if options.programs {
        return look_up_programs();
    }
    let purposes = if options.purposes.is_empty() { Purpose::value_variants() } else { &options.purposes };
    let missing = missing(purposes);
    if missing.is_empty() {
        println!("Nothing to do: everything is installed.");
        return Ok(());
    }
    if options.dry_run {
        announce(&missing);
        return Ok(());
    }
    install(&missing)
}

/// Installs what `purpose` needs and this machine lacks.
pub fn ensure(purpose: Purpose) -> Result<()> {
    let missing = missing(&[purpose]);
    if missing.is_empty() { Ok(()) } else { install(&missing) }
}

fn look_up_programs() -> Result<()> {
    let mut missing = Vec::new();
    for program in Program::ALL {
        match program.find() {
            Some(file) => println!("{:<16} {}", program.name(), file.display()),
            None => missing.push(program.name()),
        }
    }
    ensure!(
        missing.is_empty(),
        "not installed: {}; a step of `xtask/src/setup/steps.rs` has to install each",
        missing.join(", ")
    );
    Ok(())
}

fn missing(purposes: &[Purpose]) -> Vec<&'static SetupStep> {
    let wanted = |part| purposes.iter().any(|purpose| purpose.parts().contains(&part));
    STEPS.iter().filter(|step| wanted(step.part) && !step.is_done()).collect()
}

/// Prints the missing steps with their reasons and commands. Returns whether this system may run
/// the commands.
fn announce(missing: &[&SetupStep]) -> bool {
    eprintln!("Missing on this machine:");
    for step in missing {
        eprintln!("  {}: {}", step.what, step.why);
    }
    eprintln!("\nCommands (GDP_TARGET={}):", workspace::target().display());
    let known = is_debian_12();
    if !known {
        missing.iter().for_each(|step| eprintln!("  {}", step.elsewhere));
    }
    let packages = if known { packages(missing) } else { Vec::new() };
    packages.iter().chain(&wheels(missing)).for_each(|line| eprintln!("  {line}"));
    if known {
        missing.iter().flat_map(|step| step.commands).for_each(|line| eprintln!("  {line}"));
    }
    known
}

fn install(missing: &[&SetupStep]) -> Result<()> {
    if !announce(missing) {
        bail!("this system is not Debian 12, so nothing was installed: run the commands above, then try again");
    }
    packages(missing).iter().chain(&wheels(missing)).try_for_each(|line| execute(line))?;
    missing.iter().flat_map(|step| step.commands).try_for_each(|line| execute(line))?;
    match missing.iter().find(|step| !step.is_done()) {
        None => Ok(()),
        Some(step) => bail!("{} is still missing after its commands succeeded", step.what),
    }
}

/// Returns the commands that install the Debian packages of all steps at once, because dpkg takes
/// most of its time to start and finish.
fn packages(missing: &[&SetupStep]) -> Vec<String> {
    let names: BTreeSet<&str> = missing.iter().flat_map(|step| step.packages).copied().collect();
    if names.is_empty() {
        return Vec::new();
    }
    // Only `apt-get` needs root; the other commands must not have it.
    let prefix = if workspace::is_root() { "" } else { "sudo " };
    let apt_get = format!("{prefix}DEBIAN_FRONTEND=noninteractive apt-get");
    let names = names.into_iter().collect::<Vec<_>>().join(" ");
    vec![format!("{apt_get} update -q"), format!("{apt_get} install -y --no-install-recommends {names}")]
}

/// Returns the commands that make Python environments, and install the wheels of all steps at once
/// in each. Debian requires a separate environment.
fn wheels(missing: &[&SetupStep]) -> Vec<String> {
    let environments: BTreeSet<&str> =
        missing.iter().filter(|step| !step.wheels.is_empty()).map(|step| step.environment).collect();
    environments.into_iter().flat_map(|environment| wheels_in(environment, missing)).collect()
}

fn wheels_in(environment: &str, missing: &[&SetupStep]) -> [String; 3] {
    let steps = || missing.iter().filter(|step| step.environment == environment);
    let names: Vec<&str> = steps().flat_map(|step| step.wheels).copied().collect();
    let markers: Vec<String> =
        steps().filter_map(|step| step.marker()).map(|marker| format!("\"$GDP_TARGET/{marker}\"")).collect();
    let python = format!("\"$GDP_TARGET/{environment}/bin/python\"");
    [
        format!("/usr/bin/python3 -m venv \"$GDP_TARGET/{environment}\""),
        format!("{python} -m pip install --quiet --disable-pip-version-check {}", names.join(" ")),
        format!("touch {}", markers.join(" ")),
    ]
}

fn execute(line: &str) -> Result<()> {
    eprintln!("+ {line}");
    let mut shell = Program::Sh.command();
    shell.args(["-ec", line]).env("GDP_TARGET", workspace::target()).current_dir(workspace::root());
    shell::run(&mut shell)
}

fn is_debian_12() -> bool {
    let release = std::fs::read_to_string("/etc/os-release").unwrap_or_default();
    let has = |line: &str| release.lines().any(|l| l.replace('"', "") == line);
    has("ID=debian") && has("VERSION_ID=12")
}
