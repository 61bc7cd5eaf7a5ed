//! Runs commands, and shows the user exactly which.

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, Result, bail};
use gdp_tests::programs::{Executable, Program, own};

/// Runs `command` with the streams of this terminal. An error names the command.
pub fn run(command: &mut Command) -> Result<()> {
    let shown = show(command);
    let status = command.status().with_context(|| format!("cannot start `{shown}`"))?;
    if !status.success() {
        bail!("`{shown}` failed: {status}");
    }
    Ok(())
}

/// Prints the command on stderr, then runs it as [`run`] does.
pub fn say_and_run(command: &mut Command) -> Result<()> {
    eprintln!("+ {}", show(command));
    run(command)
}

/// Returns the cargo that runs this xtask.
pub fn cargo() -> Command {
    let mut command =
        std::env::var_os("CARGO").map_or_else(|| Program::Cargo.command(), |cargo| own(PathBuf::from(cargo)));
    command.current_dir(crate::workspace::root());
    command
}

/// Returns the trimmed stdout of a command, or `None` if it fails.
pub fn output(command: &mut Command) -> Option<String> {
    let output = command.output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

fn show(command: &Command) -> String {
    let mut words: Vec<String> = Vec::new();
    for (key, value) in command.get_envs() {
        if let Some(value) = value {
            words.push(format!("{}={}", key.to_string_lossy(), quote(&value.to_string_lossy())));
        }
    }
    words.push(quote(&command.get_program().to_string_lossy()));
    words.extend(command.get_args().map(|arg| quote(&arg.to_string_lossy())));
    words.join(" ")
}

fn quote(word: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_=+./:,@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}
