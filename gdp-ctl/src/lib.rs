//! The command line of the Global Data Plane. A library so that tests reach all of it; the binary
//! is a thin shell.
// They panic where stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod cli;
pub mod client;
pub mod ros;
