//! The log of a long-running program, on stderr. If the log cannot be written, only lines of the
//! log are lost.
//!
//! One thread writes all lines. So a full disk, a pipe whose reader has stopped or ended, or a
//! halted terminal cannot block or end the program. The Rust runtime ignores SIGPIPE; writing to a
//! pipe without a reader returns an error.

mod fields;
mod queue;

use std::io::IsTerminal;
use std::sync::OnceLock;
use std::time::Duration;

use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::format::{Format, Writer};
use tracing_subscriber::fmt::time::{FormatTime, SystemTime};
use tracing_subscriber::fmt::{MakeWriter, SubscriberBuilder};

use crate::escape::Escaped;
use fields::EscapedFields;
use queue::Queue;

/// The filter if `RUST_LOG` is not set: `info` for this project, and `error` for other crates.
/// Warnings of other crates are often about single datagrams, or about errors that this project
/// handles.
const DEFAULT_FILTER: &str = "error,gdp=info";

/// Timeout for writing the last lines when a program ends.
const LAST_LINES: Duration = Duration::from_millis(500);

static QUEUE: Queue = Queue::new();

/// The running log. Dropping it writes the last lines.
#[must_use = "the last lines are written when it is dropped"]
pub struct Log(());

/// Starts the log with the filter of `RUST_LOG`. Must be called once in a process.
pub fn start() -> Log {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(DEFAULT_FILTER));
    format(filter, std::io::stderr().is_terminal()).with_writer(Lines).init();
    start_writer();
    Log(())
}

fn format(filter: EnvFilter, colours: bool) -> SubscriberBuilder<EscapedFields, Format, EnvFilter> {
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(colours)
        .fmt_fields(EscapedFields)
        // Otherwise `eprintln!` reports formatting and write errors, and it panics if stderr fails.
        .log_internal_errors(false)
}

impl Drop for Log {
    fn drop(&mut self) {
        flush();
    }
}

/// Waits up to 500 ms for the last lines, before a process ends without dropping its [`Log`].
pub fn flush() {
    QUEUE.flush(LAST_LINES);
}

/// Returns whether this process logs. Then nothing else may write to stderr, because that could
/// block.
pub(crate) fn is_started() -> bool {
    WRITER.get() == Some(&true)
}

/// Writes an escaped line in the form of an event, without `tracing`.
pub(crate) fn write(level: &str, target: &str, text: impl std::fmt::Display) {
    start_writer();
    QUEUE.push(line(level, target, text));
}

/// Writes an escaped line without a prefix.
pub(crate) fn write_plain(text: impl std::fmt::Display) {
    QUEUE.push(format!("{}\n", Escaped(text)).into_bytes());
}

/// Whether the writer thread was started. The thread runs until the process ends.
static WRITER: OnceLock<bool> = OnceLock::new();

fn start_writer() {
    WRITER.get_or_init(|| {
        let missing = |n| format!("{n} lines of the log were dropped: it could not be written");
        let dropped = move |n| line("WARN", module_path!(), missing(n));
        let writer = std::thread::Builder::new().name("gdp-log".into());
        // If the thread cannot start, the program runs without a log.
        writer.spawn(move || QUEUE.write_to(std::io::stderr(), dropped)).is_ok()
    });
}

fn line(level: &str, target: &str, text: impl std::fmt::Display) -> Vec<u8> {
    let mut time = String::new();
    // Writing to a string cannot fail.
    let _ = SystemTime.format_time(&mut Writer::new(&mut time));
    format!("{time} {level:>5} {target}: {}\n", Escaped(text)).into_bytes()
}

/// A writer that queues each call of `write` as one event.
struct Lines;

impl MakeWriter<'_> for Lines {
    type Writer = Self;

    fn make_writer(&self) -> Self {
        Self
    }
}

impl std::io::Write for Lines {
    fn write(&mut self, event: &[u8]) -> std::io::Result<usize> {
        QUEUE.push(event.to_vec());
        Ok(event.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
#[path = "../../tests/unit/log.rs"]
mod tests;
