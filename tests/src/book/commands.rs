//! Checks that the commands in documents exist, with their options and values. A renamed option
//! makes the test fail that names the document.

use anyhow::Result;
use clap::builder::OsStringValueParser;
use clap::error::ErrorKind;

use super::{console, documents};

/// A command line of a document.
pub struct CommandLine {
    /// The path and line of its block, for messages.
    pub at: String,
    /// The program and its arguments.
    pub words: Vec<String>,
    /// Whether it is a mention in running text, which may lack arguments.
    pub is_mention: bool,
}

/// Returns a line for each command of `program` in a document that `command` would refuse.
pub fn problems(program: &str, command: &clap::Command) -> Result<Vec<String>> {
    let lines = of(program)?;
    anyhow::ensure!(!lines.is_empty(), "no document has a command of {program}");
    Ok(lines.iter().filter_map(|line| line.problem(command)).collect())
}

/// Returns every command line of a program in `sh` and `console` blocks and in running text.
fn of(program: &str) -> Result<Vec<CommandLine>> {
    let mut lines = Vec::new();
    for document in documents()? {
        for block in document.blocks() {
            let typed: Vec<String> = match block.language.as_str() {
                "sh" => block.text.replace("\\\n", " ").lines().map(str::to_owned).collect(),
                "console" => console::steps(&block).into_iter().map(|step| step.command).collect(),
                _ => continue,
            };
            let found = typed.iter().flat_map(|line| commands(line));
            let found = found.filter_map(|words| of_program(program, words));
            lines.extend(found.map(|words| CommandLine { at: block.at.clone(), words, is_mention: false }));
        }
        // Decisions also mention commands that are gone.
        if document.path.ends_with("decisions.md") {
            continue;
        }
        for (at, code) in document.inline_code() {
            let found = commands(&code).into_iter().filter_map(|words| of_program(program, words));
            lines.extend(found.map(|words| CommandLine { at: at.clone(), words, is_mention: true }));
        }
    }
    Ok(lines)
}

/// Splits a line of a shell into its commands: at pipes and lists, and at substitutions.
fn commands(line: &str) -> Vec<Vec<String>> {
    let mut line = line.to_owned();
    let mut found = Vec::new();
    while let Some((at, inner, end)) = line.rfind("$(").and_then(|at| {
        let end = at + line[at..].find(')')?;
        Some((at, line[at + 2..end].to_owned(), end))
    }) {
        found.extend(commands(&inner));
        line.replace_range(at..=end, "SUBSTITUTED");
    }
    let mut current = Vec::new();
    let mut is_redirected = false;
    for word in shlex::Shlex::new(&line) {
        match word.as_str() {
            "|" | "||" | "&&" | ";" | "&" => {
                found.push(std::mem::take(&mut current));
                is_redirected = false;
            }
            word if [">", ">>", "<", "2>"].iter().any(|sign| word.starts_with(sign)) => is_redirected = true,
            word if !is_redirected => current.push(word.trim_end_matches(';').to_owned()),
            _ => {}
        }
    }
    found.push(current);
    found
}

/// Returns the words from the program on, if the command is of this program.
fn of_program(program: &str, words: Vec<String>) -> Option<Vec<String>> {
    let is_before = |word: &&String| *word == "sudo" || word.split_once('=').is_some_and(|(name, _)| is_variable(name));
    let before = words.iter().take_while(is_before).count();
    let words = words[before..].to_vec();
    let name = words.first()?.rsplit('/').next()?;
    (name == program).then_some(words)
}

fn is_variable(name: &str) -> bool {
    !name.is_empty() && name.chars().all(|c| c.is_ascii_uppercase() || c == '_')
}

/// Returns whether a word stands for something that the reader has: `HOST`, `$ROBOT`, `7e2…52e`, or
/// a key file, which would be read.
fn is_placeholder(word: &str) -> bool {
    let capitals = |pair: &[u8]| pair.iter().all(u8::is_ascii_uppercase);
    word.contains(['$', '…']) || word.ends_with(".pem") || word.as_bytes().windows(2).any(capitals)
}

impl CommandLine {
    fn problem(&self, command: &clap::Command) -> Option<String> {
        // Brackets show what is optional. Bars separate alternatives, of which the first counts.
        let plain = |word: &String| match word.trim_matches(['[', ']']) {
            word if self.is_mention => word.split('|').next().unwrap_or_default().to_owned(),
            word => word.to_owned(),
        };
        let words: Vec<String> = self.words.iter().map(plain).collect();
        if self.is_mention && (words.len() == 1 || words.iter().any(|word| word == "…")) {
            return None;
        }
        let is_loose = self.is_mention || words.iter().any(|word| is_placeholder(word));
        let command = if is_loose { loose(command.clone()) } else { command.clone() };
        let error = command.try_get_matches_from(&words).err()?;
        let is_incomplete = matches!(
            error.kind(),
            ErrorKind::MissingRequiredArgument
                | ErrorKind::MissingSubcommand
                | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand
                | ErrorKind::InvalidValue
                | ErrorKind::TooFewValues
                | ErrorKind::WrongNumberOfValues
        );
        let is_help = matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion);
        if is_help || (self.is_mention && is_incomplete) {
            return None;
        }
        let reason = error.to_string();
        let reason = reason.split("\n\n").next().unwrap_or_default();
        Some(format!("{}: `{}`: {reason}", self.at, self.words.join(" ")))
    }
}

/// Returns the command with arguments of any value.
fn loose(command: clap::Command) -> clap::Command {
    let takes_values = |argument: &clap::Arg| argument.get_action().takes_values();
    command
        .mut_args(|argument| match takes_values(&argument) {
            true => argument.value_parser(OsStringValueParser::new()),
            false => argument,
        })
        .mut_subcommands(loose)
}

#[cfg(test)]
#[path = "../../tests/unit/book/commands.rs"]
mod tests;
