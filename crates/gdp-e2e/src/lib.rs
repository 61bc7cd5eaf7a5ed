//! End-to-end messages, sans-IO: sealing, segmentation, retransmission, congestion control.
//!
//! Callers provide the time and transmit the frames. [`keys`] contains the keys of epochs and
//! pairs, and [`seal`] the sealed segments. [`feedback_wire`] contains the reports of readers, and
//! [`transport`] the scheduling of frames.
// `print!` and `eprint!` panic when stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod feedback_wire;
pub mod keys;
pub mod seal;
pub mod transport;
#[cfg(test)]
#[path = "../../gdp-core/tests/unit/published_vectors.rs"]
mod vectors;
