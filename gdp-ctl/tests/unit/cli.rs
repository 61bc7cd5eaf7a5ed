//! Unit tests of `cli`.

use clap::CommandFactory;
use gdp_tests::book::reference::{self, page, table, wrapped};
use gdp_tests::book::{command_line, commands};
use schemars::schema_for;
use serde_json::Value;

use super::*;

#[test]
fn the_command_line_is_consistent() {
    Cli::command().debug_assert();
}

#[test]
fn the_reference_page_is_this_command_line() {
    reference::check("docs/reference/gdp-ctl.md", &command_line::write(Cli::command()));
}

#[test]
fn the_commands_in_documents_exist() {
    let problems = commands::problems("gdp-ctl", &Cli::command()).unwrap();
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

#[test]
fn the_reference_page_has_the_error_codes() {
    let codes = Value::from(schema_for!(ErrorCode));
    let refusals = Value::from(schema_for!(gdp_proto::control::RefusalCode));
    let introduction = "A command that fails prints its reason, and after a semicolon the remedy. With `-j` it also \
                        prints `{\"v\":2,\"error\":{\"code\":…,\"reason\":…,\"remedy\":…}}` on stdout. \
                        [Every message, its cause and its remedy](../troubleshoot.md) has more. \
                        [gdp-proxy](gdp-proxy.md) states its exit status on its page.";
    let status = Cli::command().get_after_help().map(ToString::to_string).unwrap_or_default();
    let body = wrapped(introduction)
        + "## Exit status\n\n"
        + &wrapped(&status)
        + "## Codes of a command\n\n"
        + &table(&["code", "meaning"], &rows(&codes))
        + "## Codes of a refusal\n\n"
        + &wrapped("The daemon, or a RIB behind it, refused the request.")
        + &table(&["code", "meaning"], &rows(&refusals));
    reference::check("docs/reference/errors.md", &page("Exit status and error codes", &body));
}

/// Returns the values of an enumeration with their descriptions.
fn rows(schema: &Value) -> Vec<Vec<String>> {
    let values = schema["oneOf"].as_array().or(schema["anyOf"].as_array()).expect("alternatives").iter();
    let row = |value: &Value| {
        let code = value["const"].as_str()?;
        Some(vec![format!("`{code}`"), value["description"].as_str().unwrap_or_default().to_owned()])
    };
    values.filter_map(row).collect()
}
