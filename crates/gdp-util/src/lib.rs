//! Helpers that the daemon, the proxy and the command line share. They know nothing of GDP.
//!
//! - [`backoff`]: delays between attempts
//! - [`escape`]: text of strangers, without the characters that a terminal obeys
//! - [`file_watch`]: files that others replace (feature `watch`)
//! - [`log`]: the log of a long-running program, which neither blocks nor panics (feature
//!   `program`)
//! - [`panics`]: a task or thread that panics ends the process (feature `program`)
//! - [`terminal`]: lines for people (feature `program`)
//! - [`unix_time`]: this machine's clock
// They panic where stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod backoff;
pub mod escape;
#[cfg(feature = "watch")]
pub mod file_watch;
#[cfg(feature = "program")]
pub mod log;
#[cfg(feature = "program")]
pub mod panics;
#[cfg(feature = "program")]
pub mod terminal;
pub mod unix_time;
