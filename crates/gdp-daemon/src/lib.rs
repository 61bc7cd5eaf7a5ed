//! The daemon: a switch, perhaps the RIB of its domain, the admin socket, and what they store.
// The print macros panic where stdout or stderr is not writable.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod config;
pub mod doctor;
pub mod domain;
pub mod privileges;
pub mod serve;
pub mod store;
