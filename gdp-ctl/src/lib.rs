//! The command line of the Global Data Plane. It is a library so that tests can call all of it. The
//! binary only calls the library.
// Both macros panic if stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod cli;
pub mod client;
pub mod ros;
