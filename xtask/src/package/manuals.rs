//! Manual pages and completions, which the programs write themselves.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use gdp_tests::netns::execute;
use gdp_tests::programs::{Executable as _, Program, own};

/// Shells and where their completions of a program belong.
const SHELLS: [(&str, &str, &str); 3] = [
    ("bash", "usr/share/bash-completion/completions", ""),
    ("zsh", "usr/share/zsh/vendor-completions", "_"),
    ("fish", "usr/share/fish/vendor_completions.d", ""),
];

/// Writes the manual pages and completions of `name` below `tree`. `program` runs on this machine.
pub fn write(name: &str, program: &Path, tree: &Path) -> Result<()> {
    let pages = tree.join("usr/share/man/man1");
    fs::create_dir_all(&pages)?;
    execute(own(program).arg("manual").arg(&pages))?;
    for entry in fs::read_dir(&pages)? {
        let page = entry?.path();
        // clap_mangen dates no page, so equal sources make equal pages.
        execute(Program::Gzip.command().args(["-9n"]).arg(&page)).with_context(|| page.display().to_string())?;
    }
    for (shell, folder, prefix) in SHELLS {
        let suffix = if shell == "fish" { ".fish" } else { "" };
        let file = tree.join(folder).join(format!("{prefix}{name}{suffix}"));
        fs::create_dir_all(tree.join(folder))?;
        fs::write(&file, execute(own(program).args(["completion", shell]))? + "\n")?;
    }
    Ok(())
}
