//! A model of bad links for tests. A seed and the given times alone decide the fate of each frame.
//! It is not part of the product.
//!
//! - [`Faults`]: the faults of one direction of a link
//! - [`Link`]: a queue of frames with these faults
//! - [`Network`]: nodes joined by links, in simulated time
//! - [`Random`]: the random numbers that decide
//!
//! The crate does no I/O and has no clock. Time is in nanoseconds since any start, as `u64`.
//! Property tests run the model in simulated time. The harness in `tests` runs the same model by
//! the real clock, between network namespaces.
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

/// One microsecond in nanoseconds, the unit of all times in this crate.
pub const MICROSECOND: u64 = 1_000;
pub const MILLISECOND: u64 = 1_000_000;
pub const SECOND: u64 = 1_000_000_000;
