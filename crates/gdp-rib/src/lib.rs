//! The routing information base (RIB) of a domain, its tiers and its topology, as state machines
//! without I/O and without a clock.
//!
//! [`rib`] answers the requests of entities, [`tiers`] exchanges records between domains,
//! [`topology`] computes paths. [`leadership`] selects one of several replicas.
// These macros panic if stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod crossing;
pub mod deadlines;
mod delta_sync;
pub mod feed;
pub mod leadership;
pub mod rib;
pub mod tiers;
pub mod topology;

// Tests of other crates include this crate's test domains, which name it from outside.
#[cfg(test)]
extern crate self as gdp_rib;
