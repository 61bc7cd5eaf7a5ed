//! Unit tests of `run`.

use clap::Parser;

use super::*;

#[derive(Parser)]
struct Line {
    #[command(flatten)]
    options: Options,
}

/// `cargo xtask run -- --interface DEV`, as README says it.
#[test]
fn what_is_behind_two_dashes_is_for_the_daemon() {
    let arguments = |line: &[&str]| Line::try_parse_from(line).map(|line| line.options.arguments);
    assert_eq!(arguments(&["run", "--", "--interface", "eth1"]).expect("valid"), ["--interface", "eth1"]);
    assert!(arguments(&["run"]).expect("valid").is_empty());
}
