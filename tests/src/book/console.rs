//! Blocks of the language `console`: what people type, and what they then read.
//!
//! A line `MACHINE$ COMMAND` is typed on that machine. The lines below it are what the command
//! prints there. In them, `…` stands for text that differs from run to run.

use super::Block;

/// A command, and what it prints.
pub struct Step {
    /// The path and line of the block, for messages.
    pub at: String,
    /// The machine on which the command is typed.
    pub machine: String,
    pub command: String,
    pub output: Vec<String>,
}

/// Returns the machine and the command of a line that is typed.
pub fn typed(line: &str) -> Option<(&str, &str)> {
    let (machine, command) = line.split_once("$ ")?;
    let is_name = !machine.is_empty() && machine.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit());
    is_name.then_some((machine, command))
}

/// Returns the steps of a block. A command that ends with `\` goes on in the next line.
pub fn steps(block: &Block) -> Vec<Step> {
    let mut steps: Vec<Step> = Vec::new();
    for line in block.text.lines() {
        match (typed(line), steps.last_mut()) {
            (Some((machine, command)), _) => steps.push(Step {
                at: block.at.clone(),
                machine: machine.to_owned(),
                command: command.to_owned(),
                output: Vec::new(),
            }),
            (None, Some(step)) if step.output.is_empty() && step.command.ends_with('\\') => {
                step.command.pop();
                step.command.push_str(line.trim_start());
            }
            (None, Some(step)) => step.output.push(line.to_owned()),
            (None, None) => {}
        }
    }
    steps
}

/// Returns whether a printed line is as a document shows it. White space counts as one space,
/// because the widths of columns follow their content.
pub fn is_as_shown(shown: &str, printed: &str) -> bool {
    let normal = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    let (shown, printed) = (normal(shown), normal(printed));
    let mut parts = shown.split('…');
    let Some(mut rest) = parts.next().and_then(|first| printed.strip_prefix(first)) else { return false };
    let parts: Vec<&str> = parts.collect();
    let Some((last, middle)) = parts.split_last() else { return rest.is_empty() };
    for part in middle {
        match rest.split_once(part) {
            Some((_, after)) => rest = after,
            None => return false,
        }
    }
    rest.ends_with(last)
}

#[cfg(test)]
#[path = "../../tests/unit/book/console.rs"]
mod tests;
