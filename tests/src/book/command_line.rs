//! The page of a program's command line, from clap's description of it.

use clap::{Arg, Command};

use super::reference::{page, table, wrapped};

/// Returns the page of a program: its commands, each with arguments, defaults and help.
pub fn write(mut command: Command) -> String {
    command.build();
    let name = command.get_name().to_owned();
    let mut body = wrapped(&about(&command));
    body += &usage(&command);
    body += &arguments(&command, |_| true);
    for inner in command.get_subcommands() {
        section(inner, &mut body);
    }
    page(&name, &body)
}

fn section(command: &Command, body: &mut String) {
    if command.is_hide_set() || command.get_name() == "help" {
        return;
    }
    let name = command.get_bin_name().unwrap_or(command.get_name());
    body.push_str(&format!("## {name}\n\n"));
    body.push_str(&wrapped(&about(command)));
    if command.has_subcommands() {
        for inner in command.get_subcommands() {
            section(inner, body);
        }
        return;
    }
    body.push_str(&usage(command));
    body.push_str(&arguments(command, |argument| !argument.is_global_set()));
}

/// Returns what a command does, with the text below its help. Each line ends with a full stop.
fn about(command: &Command) -> String {
    let about = command.get_long_about().or(command.get_about()).map(ToString::to_string).unwrap_or_default();
    let after = command.get_after_long_help().or(command.get_after_help()).map(ToString::to_string);
    let sentences = |text: String| text.split("\n\n").map(sentence).collect::<Vec<_>>().join("\n\n");
    [about, after.unwrap_or_default()].map(sentences).join("\n\n")
}

fn sentence(text: &str) -> String {
    let text = text.trim();
    if text.is_empty() || text.ends_with(['.', ':', '?', '`']) { text.to_owned() } else { format!("{text}.") }
}

fn usage(command: &Command) -> String {
    let usage = command.clone().render_usage().to_string();
    let usage: Vec<&str> = usage.trim_start_matches("Usage:").lines().map(str::trim).collect();
    format!("```text\n{}\n```\n\n", usage.join("\n"))
}

fn arguments(command: &Command, is_wanted: impl Fn(&Arg) -> bool) -> String {
    let listed = command.get_arguments().filter(|argument| {
        let is_common = ["help", "version"].contains(&argument.get_id().as_str());
        !argument.is_hide_set() && !is_common && is_wanted(argument)
    });
    let rows: Vec<Vec<String>> =
        listed.map(|argument| vec![name(argument), default(argument), help(argument)]).collect();
    table(&["argument", "default", "meaning"], &rows)
}

fn name(argument: &Arg) -> String {
    let values = match argument.get_action().takes_values() {
        true => argument.get_value_names().unwrap_or_default().iter().map(|value| value.to_string()).collect(),
        false => vec![],
    };
    let short = argument.get_short().map(|short| format!("`-{short}`"));
    let long =
        argument.get_long().map(|long| format!("`{}`", [vec![format!("--{long}")], values.clone()].concat().join(" ")));
    match (short, long) {
        (None, None) => format!("`{}`", values.join(" ")),
        (short, long) => [short, long].into_iter().flatten().collect::<Vec<_>>().join(", "),
    }
}

fn default(argument: &Arg) -> String {
    let values = argument.get_default_values().iter().map(|value| format!("`{}`", value.to_string_lossy()));
    match argument.is_required_set() {
        true => "required".to_owned(),
        false if argument.get_action().takes_values() => values.collect::<Vec<_>>().join(", "),
        false => String::new(),
    }
}

fn help(argument: &Arg) -> String {
    let text = argument.get_long_help().or(argument.get_help()).map(ToString::to_string).unwrap_or_default();
    assert!(!text.is_empty(), "{} needs a doc comment", argument.get_id());
    let mut help = sentence(&text);
    let values: Vec<String> = match argument.get_action().takes_values() {
        true => argument.get_possible_values().iter().filter(|value| !value.is_hide_set()).map(value).collect(),
        false => vec![],
    };
    if !values.is_empty() {
        help += &format!(" One of: {}.", values.join("; "));
    }
    if let Some(variable) = argument.get_env() {
        help += &format!(" Environment: `{}`.", variable.to_string_lossy());
    }
    help
}

fn value(value: &clap::builder::PossibleValue) -> String {
    let help = value.get_help().map(|help| format!(" ({})", help.to_string().trim_end_matches('.')));
    format!("`{}`{}", value.get_name(), help.unwrap_or_default())
}
