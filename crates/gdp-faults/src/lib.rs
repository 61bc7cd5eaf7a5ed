//! Bad links, as a model: what happens to frames, decided by a seed and a given time alone. For
//! tests; no part of the product.
//!
//! - [`Faults`]: what is wrong with one direction of a link; [`Link`]: frames through it
//! - [`Network`]: nodes joined by links, in simulated time
//! - [`Random`]: the numbers that decide
//!
//! No I/O and no clock. Time is nanoseconds since any beginning, in `u64`. Property tests drive it
//! in simulated time; the harness in `tests` drives the same model by the real clock, between
//! network namespaces.
#![deny(unsafe_code)]

mod faults;
mod link;
mod network;
mod random;

#[cfg(test)]
#[path = "../tests/unit/lib.rs"]
mod tests;

pub use faults::{Burst, Faults, Reorder};
pub use link::{Counts, Delivery, Link};
pub use network::{Arrival, Cable, Network};
pub use random::Random;

/// In nanoseconds, as all times here.
pub const MICROSECOND: u64 = 1_000;
pub const MILLISECOND: u64 = 1_000_000;
pub const SECOND: u64 = 1_000_000_000;
