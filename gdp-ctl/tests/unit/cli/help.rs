//! Unit tests of `cli::help`.

use clap::CommandFactory;

use super::*;
use crate::cli::Cli;

#[test]
fn every_command_is_in_one_group() {
    let command = Cli::command();
    let names: Vec<&str> = GROUPS.iter().flat_map(|(_, names)| *names).copied().collect();
    let shown = || command.get_subcommands().filter(|command| !command.is_hide_set());
    for name in shown().map(Command::get_name) {
        assert_eq!(names.iter().filter(|grouped| **grouped == name).count(), 1, "{name}: put it into GROUPS");
    }
    assert_eq!(shown().count(), names.len(), "a command of GROUPS does not exist");
}

#[test]
fn help_lists_each_command_on_one_line() {
    let help = grouped(Cli::command()).render_help().to_string();
    for (title, names) in GROUPS {
        assert!(help.contains(&format!("\n{title}:\n")), "{help}");
        for name in names {
            let lines: Vec<&str> = help.lines().filter(|line| line.starts_with(&format!("  {name} "))).collect();
            assert!(lines.len() == 1 && lines[0].chars().count() <= 100, "{name}: {lines:?}");
        }
    }
    assert!(help.contains("--socket") && help.contains("Exit status"), "{help}");
}
