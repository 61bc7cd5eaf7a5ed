//! `cargo xtask models`: checks the protocols in `models/protocols` with Verifpal, and changed
//! copies of them whose attacks must be found.
//!
//! A model that is checked says little unless the checker would find the attack. So each variant
//! leaves out one check, or gives the attacker one key, and names the result that it must have.

mod variants;

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use gdp_tests::programs::own;

use self::variants::{PROTOCOLS, Protocol, VARIANTS, Variant};
use crate::setup::{self, Purpose, installed_by_cargo};
use crate::{shell, workspace};

#[derive(clap::Args)]
pub struct Options {
    /// Check two concurrent sessions of each protocol, which takes minutes
    #[arg(long)]
    thorough: bool,
}

pub fn run(options: Options) -> Result<()> {
    setup::ensure(Purpose::Models)?;
    let folder = tempfile::tempdir()?;
    let mut unexpected = 0;
    for protocol in &PROTOCOLS {
        let model = read(protocol.file)?;
        let sessions = if options.thorough { 2 } else { protocol.sessions };
        unexpected += usize::from(!holds(folder.path(), protocol, &model, sessions)?);
    }
    for variant in &VARIANTS {
        unexpected += usize::from(!has_result(folder.path(), variant)?);
    }
    ensure!(unexpected == 0, "{unexpected} results differ from what `xtask/src/models/variants.rs` states");
    Ok(())
}

/// Checks a protocol. Returns whether no query has an attack.
fn holds(folder: &Path, protocol: &Protocol, model: &str, sessions: u8) -> Result<bool> {
    let code = verify(folder, model, sessions)?;
    let holds = !code.is_empty() && !code.contains('1');
    println!("{} {}, {sessions} sessions: {code}", mark(holds), protocol.file);
    Ok(holds)
}

/// Checks a variant. Returns whether its result is the stated one.
fn has_result(folder: &Path, variant: &Variant) -> Result<bool> {
    let code = verify(folder, &variant.apply(&read(variant.of)?)?, variant.sessions)?;
    let is_expected = code == variant.result;
    println!("{} {}, {}: {code}, expected {}", mark(is_expected), variant.of, variant.what, variant.result);
    Ok(is_expected)
}

/// Returns a letter and a digit for each query: 1 stands for an attack.
fn verify(folder: &Path, model: &str, sessions: u8) -> Result<String> {
    let file = folder.join("model.vp");
    std::fs::write(&file, model).with_context(|| format!("cannot write {}", file.display()))?;
    let program = installed_by_cargo(gdp_tests::programs::Program::Verifpal).context("verifpal is not installed")?;
    let mut command = own(program);
    command.arg("verify").arg(&file).args(["--sessions", &sessions.to_string(), "--quiet", "--result-code"]);
    match shell::output(&mut command) {
        Some(code) => Ok(code),
        None => bail!("verifpal cannot read a model:\n{model}"),
    }
}

fn read(name: &str) -> Result<String> {
    let file = workspace::root().join("models/protocols").join(name);
    std::fs::read_to_string(&file).with_context(|| format!("cannot read {}", file.display()))
}

fn mark(is_expected: bool) -> &'static str {
    if is_expected { "ok  " } else { "FAIL" }
}
