//! Unit tests of `book::commands`.

use clap::{Arg, Command};

use super::*;

fn program() -> Command {
    let number = Arg::new("number").long("number").value_parser(clap::value_parser!(u16));
    Command::new("p").subcommand_required(true).subcommand(Command::new("do").arg(number).arg(Arg::new("file")))
}

fn line(text: &str, is_mention: bool) -> Option<String> {
    let words = commands(text).into_iter().find_map(|words| of_program("p", words))?;
    CommandLine { at: "docs/x.md:1".into(), words, is_mention }.problem(&program())
}

#[test]
fn commands_are_found_behind_sudo_pipes_and_variables() {
    let found = |text: &str| commands(text).into_iter().filter_map(|words| of_program("p", words)).collect::<Vec<_>>();
    assert_eq!(found("A=1 sudo ./p do 'a b' | q  # p no"), [["./p", "do", "a b"]]);
    assert_eq!(found("p do a > file && p do b"), [["p", "do", "a"], ["p", "do", "b"]]);
    assert_eq!(found("B=$(p do x) && q --y \"$(p do z)\""), [["p", "do", "z"], ["p", "do", "x"]]);
    assert!(found("cp a p").is_empty());
}

#[test]
fn a_renamed_command_or_option_and_a_wrong_value_are_found() {
    for good in ["p do --number 3", "p do --number NUMBER", "p do --number $N", "p do key.pem", "p --help"] {
        assert_eq!(line(good, false), None, "{good}");
    }
    for bad in ["p did", "p do --numbers 3", "p do --number x", "p", "p do a b"] {
        assert!(line(bad, false).is_some_and(|problem| problem.starts_with("docs/x.md:1: `p")), "{bad}");
    }
}

#[test]
fn a_mention_may_lack_arguments_and_show_choices() {
    for good in ["p do [--number N]", "p do|undo", "p …", "p"] {
        assert_eq!(line(good, true), None, "{good}");
    }
    assert!(line("p do --numbers", true).is_some());
}
