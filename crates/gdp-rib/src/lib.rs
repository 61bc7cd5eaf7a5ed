//! The routing information base of a domain, its tiers and its topology: state machines without I/O
//! and without a clock.
//!
//! [`rib`] answers entities' requests, [`tiers`] exchanges records between domains, [`topology`]
//! computes paths.
// They panic where stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod crossing;
pub mod deadlines;
pub mod feed;
pub mod rib;
pub mod tiers;
pub mod topology;

// Tests of other crates include this crate's test domains, which name it from outside.
#[cfg(test)]
extern crate self as gdp_rib;
