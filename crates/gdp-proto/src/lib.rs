//! The control protocol of the Global Data Plane: messages between endpoints, switches, RIBs and
//! the command line.
//!
//! It holds types, their encoding and their bounds, without I/O. [`peers`] is the receiving end of
//! one exchange, also without I/O.
// These macros panic if stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod admin;
pub mod control;
pub mod peers;
