//! Unit tests of the program `gdp-proxy`.

use clap::CommandFactory;
use gdp_tests::book::{command_line, commands, reference};

use super::*;

#[test]
fn the_command_line_is_consistent() {
    Arguments::command().debug_assert();
}

#[test]
fn the_reference_page_is_this_command_line() {
    reference::check("docs/reference/gdp-proxy.md", &command_line::write(Arguments::command()));
}

#[test]
fn the_commands_in_documents_exist() {
    let problems = commands::problems("gdp-proxy", &Arguments::command()).unwrap();
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}
