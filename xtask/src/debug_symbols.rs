//! Debug symbols in files of their own, so that executables are small and backtraces still have
//! names and lines.

use std::path::Path;

use anyhow::{Context, Result};
use gdp_tests::programs::{Executable as _, Program};

use crate::shell;

/// Moves the symbols of `PROGRAM` to `PROGRAM.debug` beside it, where debuggers and Rust's
/// backtraces find them by the `.gnu_debuglink` that stays.
pub fn split(executable: &Path) -> Result<()> {
    let (debug, stripped) = (executable.with_extension("debug"), executable.with_extension("stripped"));
    let folder = executable.parent().context("the executable is in a folder")?;
    let name = debug.file_name().context("the executable has a name")?.to_string_lossy();
    shell::run(Program::Objcopy.command().arg("--only-keep-debug").arg(executable).arg(&debug))?;
    // The link is made from the name as it is given, so objcopy runs beside the file.
    let mut strip = Program::Objcopy.command();
    strip.arg("--strip-all").arg(format!("--add-gnu-debuglink={name}")).arg(executable).arg(&stripped);
    shell::run(strip.current_dir(folder))?;
    // Not in place: Cargo's own copy is another name of the same file.
    std::fs::rename(&stripped, executable).with_context(|| format!("cannot replace {}", executable.display()))
}
