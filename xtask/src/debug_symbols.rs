//! Moves debug symbols to separate files. Executables are then small, and backtraces still have
//! names and lines.

use std::path::Path;

use anyhow::{Context, Result};
use gdp_tests::programs::{Executable as _, Program};

use crate::shell;

/// Moves the symbols of `PROGRAM` to `PROGRAM.debug` beside it. Debuggers and Rust's backtraces
/// find them by the `.gnu_debuglink` in the executable.
pub fn split(executable: &Path) -> Result<()> {
    let (debug, stripped) = (executable.with_extension("debug"), executable.with_extension("stripped"));
    let folder = executable.parent().context("the executable is in a folder")?;
    let name = debug.file_name().context("the executable has a name")?.to_string_lossy();
    shell::run(Program::Objcopy.command().arg("--only-keep-debug").arg(executable).arg(&debug))?;
    // The link contains the name as given, so objcopy runs in the folder of the file.
    let mut strip = Program::Objcopy.command();
    strip.arg("--strip-all").arg(format!("--add-gnu-debuglink={name}")).arg(executable).arg(&stripped);
    shell::run(strip.current_dir(folder))?;
    // Not in place, because Cargo's own copy is a hard link to the same file.
    std::fs::rename(&stripped, executable).with_context(|| format!("cannot replace {}", executable.display()))?;
    let megabytes = executable.metadata()?.len() as f64 / 1e6;
    eprintln!("{}: {megabytes:.1} MB, its debug symbols beside it", executable.display());
    Ok(())
}
