//! Helpers that the daemon, the proxy and the command line share. They do not depend on GDP.
//!
//! - [`backoff`]: delays between attempts
//! - [`date`]: times for people
//! - [`descriptors`]: the limit on open file descriptors (feature `descriptors`)
//! - [`escape`]: untrusted text without terminal control characters
//! - [`file_watch`]: watches for changed files (feature `watch`)
//! - [`folders`]: the folders of state, configuration and socket (feature `folders`)
//! - [`line_limit`]: a limit on log lines of one kind
//! - [`line_socket`]: the admin socket of a program (feature `socket`)
//! - [`log`]: the log of a long-running program, which neither blocks nor panics (feature
//!   `program`)
//! - [`os`]: what differs between operating systems about files
//! - [`ownership`]: the owners of what root creates (feature `folders`, on Linux)
//! - [`panics`]: ends the process when a task or thread panics (feature `program`)
//! - [`processes`]: signals to child processes (feature `program`)
//! - [`service_manager`]: notifications to systemd (feature `program`)
//! - [`services`]: the units of the packages (feature `program`)
//! - [`signals`]: the signals that end a program (feature `program`)
//! - [`terminal`]: output lines for users (feature `program`)
//! - [`text_file`]: files of people, read within a bound (feature `text-file`)
//! - [`ticks`]: common ticks for periodic work
//! - [`unix_time`]: the clock of this machine
//! - [`yaml`]: strict YAML files, with errors for people (feature `yaml`)
// These macros panic if stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod backoff;
pub mod date;
#[cfg(feature = "descriptors")]
pub mod descriptors;
pub mod escape;
#[cfg(feature = "watch")]
pub mod file_watch;
#[cfg(feature = "folders")]
pub mod folders;
pub mod line_limit;
#[cfg(feature = "socket")]
pub mod line_socket;
#[cfg(feature = "program")]
pub mod log;
pub mod os;
#[cfg(all(feature = "folders", target_os = "linux"))]
pub mod ownership;
#[cfg(feature = "program")]
pub mod panics;
#[cfg(feature = "program")]
pub mod processes;
#[cfg(feature = "program")]
pub mod service_manager;
#[cfg(feature = "program")]
pub mod services;
#[cfg(feature = "program")]
pub mod signals;
#[cfg(feature = "program")]
pub mod terminal;
#[cfg(feature = "text-file")]
pub mod text_file;
pub mod ticks;
pub mod unix_time;
#[cfg(feature = "yaml")]
pub mod yaml;
