//! The log of a long-running program, on stderr. A log that cannot be written costs lines of the
//! log, and nothing else.
//!
//! One thread writes, so that a full disk, a reader of the pipe that stopped or ended, or a
//! terminal that was halted neither blocks nor ends whoever logs. The Rust runtime ignores SIGPIPE;
//! a pipe without a reader is an error of `write`.

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

/// What is logged if `RUST_LOG` is not set: this project's own information, and only errors of
/// other crates, whose warnings are often about single datagrams or about what we handle.
const DEFAULT_FILTER: &str = "error,gdp=info";

/// How long a program that ends waits for its last lines to be written.
const LAST_LINES: Duration = Duration::from_millis(500);

static QUEUE: Queue = Queue::new();

/// Logs from now on, until it is dropped; then what is logged last is written.
#[must_use = "the last lines are written when it is dropped"]
pub struct Log(());

/// Logs what `RUST_LOG` says to stderr. Once in a process.
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
        // Or what cannot be formatted or written is reported by `eprintln!`, which panics if stderr
        // fails.
        .log_internal_errors(false)
}

impl Drop for Log {
    fn drop(&mut self) {
        flush();
    }
}

/// Waits a moment for the last lines, before a process ends without dropping its [`Log`].
pub fn flush() {
    QUEUE.flush(LAST_LINES);
}

/// Whether this process logs; then nothing else may write to stderr, because it could block.
pub(crate) fn is_started() -> bool {
    WRITER.get() == Some(&true)
}

/// Writes a line, escaped, that looks like an event of this level and target, without going through
/// `tracing`.
pub(crate) fn write(level: &str, target: &str, text: impl std::fmt::Display) {
    start_writer();
    QUEUE.push(line(level, target, text));
}

/// Writes a line, escaped, with nothing before it.
pub(crate) fn write_plain(text: impl std::fmt::Display) {
    QUEUE.push(format!("{}\n", Escaped(text)).into_bytes());
}

/// Whether the thread that writes could be started; it runs as long as the process.
static WRITER: OnceLock<bool> = OnceLock::new();

fn start_writer() {
    WRITER.get_or_init(|| {
        let missing = |n| format!("{n} lines of the log were dropped: it could not be written");
        let dropped = move |n| line("WARN", module_path!(), missing(n));
        let writer = std::thread::Builder::new().name("gdp-log".into());
        // Without the thread nothing is logged: the program is more than its log.
        writer.spawn(move || QUEUE.write_to(std::io::stderr(), dropped)).is_ok()
    });
}

fn line(level: &str, target: &str, text: impl std::fmt::Display) -> Vec<u8> {
    let mut time = String::new();
    // It writes to a string, which cannot fail.
    let _ = SystemTime.format_time(&mut Writer::new(&mut time));
    format!("{time} {level:>5} {target}: {}\n", Escaped(text)).into_bytes()
}

/// Each call of its `write` is one event.
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
