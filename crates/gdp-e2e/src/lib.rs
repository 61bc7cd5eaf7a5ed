//! Messages end to end, sans-IO: sealing, segmentation, retransmission, congestion control.
//!
//! Callers bring the time and carry the frames. Keys of epochs and pairs are in [`keys`], sealed
//! segments in [`seal`], what readers report in [`feedback_wire`], and the scheduling of frames in
//! [`transport`].
// They panic where stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod feedback_wire;
pub mod keys;
pub mod seal;
pub mod transport;
#[cfg(test)]
#[path = "../../gdp-core/tests/unit/published_vectors.rs"]
mod vectors;
