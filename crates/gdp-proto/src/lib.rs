//! The control protocol of the Global Data Plane: messages between endpoints, switches, RIBs and
//! the command line.
//!
//! Types, their encoding and their bounds; no I/O. [`peers`] is the receiving end of one exchange,
//! sans-IO.
// They panic where stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod admin;
pub mod control;
pub mod peers;
