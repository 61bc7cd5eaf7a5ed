//! People who do what the pages of Start and Operate show, word by word. Each command is typed on
//! the machine of its prompt, and has to print what the page shows (`gdp_tests::book::console`).
//!
//! ```text
//!   robot7 ── nat ──┐
//!   robot8 ── nat ──┼── internet ── server (203.0.113.7)
//!   laptop ── nat ──┘
//! ```
//!
//! Members have no address that others reach, and each machine has files of its own.

mod machine;
mod terminal;

use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use gdp_tests::book::console::{self, Step};
use gdp_tests::book::{Document, file_of};
use gdp_tests::wait::{TIMEOUT, check_interrupt};

use machine::Site;
use terminal::Terminal;

#[test]
fn the_first_topic_is_as_on_its_page() -> Result<()> {
    follow("docs/start.md", &["server", "robot7"])
}

#[test]
fn keys_names_and_grants_by_hand_are_as_on_their_page() -> Result<()> {
    follow("docs/by-hand.md", &["server"])
}

#[test]
fn the_days_of_a_domain_are_as_on_their_page() -> Result<()> {
    follow("docs/operate.md", &["server", "robot7", "robot8", "laptop"])
}

/// Types every command of a page, in their order.
fn follow(page: &str, machines: &[&str]) -> Result<()> {
    let document = Document::read(page)?;
    let mut site = Site::build(machines)?;
    let mut reader = Reader::default();
    let begun = Instant::now();
    for block in document.blocks() {
        match (block.language.as_str(), file_of(&block)) {
            ("console", _) => {
                for step in console::steps(&block) {
                    reader.do_step(&mut site, &step).with_context(|| format!("{}: {}", step.at, step.command))?;
                }
            }
            ("yaml", Some(name)) => site.machine("server")?.write(name, &block.text)?,
            (language, _) => bail!("{}: a block of {language:?} cannot be followed", block.at),
        }
    }
    println!("{page}: {} commands in {} s", reader.commands, begun.elapsed().as_secs());
    Ok(())
}

/// A person with the page, who copies from one terminal into another.
#[derive(Default)]
struct Reader {
    commands: usize,
    invitation: String,
    fingerprint: String,
}

impl Reader {
    fn do_step(&mut self, site: &mut Site, step: &Step) -> Result<()> {
        self.commands += 1;
        let mut shown = step.output.clone();
        let is_interrupted = shown.last().is_some_and(|line| line == "^C");
        if is_interrupted {
            shown.pop();
        }
        let machine = site.machine(&step.machine)?;
        let mut terminal = machine.open(&step.command)?;
        let deadline = Instant::now() + TIMEOUT;
        loop {
            let has_ended = terminal.has_ended()?;
            let text = terminal.text();
            self.read(&text, &mut terminal)?;
            let printed: Vec<&str> = text.lines().collect();
            if is_shown(&shown, &printed, !has_ended) {
                break;
            }
            let seen = || format!("it printed:\n{text}\nand the page shows:\n{}", shown.join("\n"));
            ensure!(!has_ended, "{}", seen());
            ensure!(Instant::now() < deadline, "after {TIMEOUT:?} {}", seen());
            check_interrupt()?;
            std::thread::sleep(Duration::from_millis(20));
        }
        if is_interrupted {
            return terminal.interrupt();
        }
        let has_ended = terminal.ends_within(Duration::from_millis(1500))?;
        let text = terminal.text();
        println!("{}$ {}\n{text}", step.machine, step.command);
        if !has_ended {
            machine.keep(terminal);
            return Ok(());
        }
        ensure!(is_shown(&shown, &text.lines().collect::<Vec<_>>(), false), "more than the page shows: {text}");
        Ok(())
    }

    /// Remembers what is worth copying, and types it where a program asks for it.
    fn read(&mut self, text: &str, terminal: &mut Terminal) -> Result<()> {
        if terminal.asks("then press Enter:\n") {
            terminal.type_line(&self.invitation)?;
        } else if terminal.asks("Type it to approve:\n") {
            terminal.type_line(&self.fingerprint)?;
        }
        let words = text.split_whitespace();
        if let Some(line) = words.clone().rfind(|word| word.starts_with("gdp1")) {
            line.clone_into(&mut self.invitation);
        }
        if let Some(fingerprint) = text.rsplit("ingerprint: ").next().filter(|rest| *rest != text) {
            fingerprint.lines().next().unwrap_or_default().clone_into(&mut self.fingerprint);
        }
        Ok(())
    }
}

/// Returns whether all lines of a page are printed in their order, and nothing else. A line `…` of
/// the page stands for any lines. A program that still runs may print more.
fn is_shown(shown: &[String], printed: &[&str], may_print_more: bool) -> bool {
    match (shown.split_first(), printed.split_first()) {
        (None, printed) => may_print_more || printed.is_none(),
        (Some((first, rest)), _) if first == "…" => {
            (0..=printed.len()).any(|skipped| is_shown(rest, &printed[skipped..], may_print_more))
        }
        (Some((first, rest)), Some((line, others))) => {
            console::is_as_shown(first, line) && is_shown(rest, others, may_print_more)
        }
        (Some(_), None) => false,
    }
}
