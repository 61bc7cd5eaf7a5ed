//! Unit tests of `cli::schema`.

use std::collections::BTreeSet;

use clap::CommandFactory;
use gdp_tests::book::reference;

use super::super::Cli;
use super::*;

#[test]
fn the_published_schema_is_this_one() {
    reference::check("docs/gdp-ctl.schema.json", &(serde_json::to_string_pretty(&schema()).unwrap() + "\n"));
}

#[test]
fn every_command_that_prints_has_a_schema() {
    let runs = |verb: &String| ["serve", "up", "top", "join-service", "completion", "manual"].contains(&verb.as_str());
    let verbs: BTreeSet<_> = leaves(&Cli::command(), "").into_iter().filter(|verb| !runs(verb)).collect();
    let described = OUTPUTS.iter().map(|(verb, _)| (*verb).to_owned()).filter(|verb| verb != "error");
    assert_eq!(described.collect::<BTreeSet<_>>(), verbs);
}

/// Returns the commands without subcommands, as a user types them.
fn leaves(command: &clap::Command, typed: &str) -> Vec<String> {
    let mut leaves = Vec::new();
    for inner in command.get_subcommands() {
        let typed = format!("{typed} {}", inner.get_name()).trim_start().to_owned();
        if inner.has_subcommands() {
            leaves.extend(self::leaves(inner, &typed));
        } else {
            leaves.push(typed);
        }
    }
    leaves
}
