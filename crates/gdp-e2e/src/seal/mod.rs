//! Seals messages end to end (`docs/architecture.md`, "A message").
//!
//! A [`Writer`] splits a message into segments, seals each with AES-256-GCM under its session's
//! key, and signs a Merkle root over all of them. A [`Reader`] opens, reassembles and verifies.
//! `docs/wire-format.md`, "Sealed segments", specifies the encoding.
//!
//! The module has no sockets and no clocks: callers provide the time and transmit the frame
//! payloads. Callers also authorise writers and interpret the body.

mod assembly;
mod delivery;
mod drop_reason;
mod event;
mod heartbeat;
mod merkle;
mod message;
mod plan;
mod reader;
mod seal_error;
mod segment;
mod segments;
mod session;
mod signed_parts;
mod source;
mod used_cuts;
mod window;
mod wire;
mod writer;

pub use crate::seal::event::{Heartbeat, Lost, ReaderLimits, Received, Timestamps};
pub use drop_reason::DropReason;
pub use message::{Draft, Encoding, Latched, MAX_ORIGIN, Message, MessageId};
pub use reader::Reader;
pub use seal_error::SealError;
pub use segment::{SegmentId, segment_ids};
pub use segments::Segments;
pub use window::ReplayWindow;
pub use wire::VERSION as SEGMENT_VERSION;
pub use wire::{MAX_BATCH, MAX_CUT, MIN_PAYLOAD};
pub use writer::{MAX_SEGMENTS, Writer};

#[cfg(test)]
#[path = "../../tests/unit/seal/equivocation.rs"]
mod equivocation;
#[cfg(test)]
#[path = "../../tests/unit/seal/hostile_tests.rs"]
mod hostile_tests;
#[cfg(test)]
#[path = "../../tests/unit/seal/property_tests.rs"]
mod property_tests;
#[cfg(test)]
#[path = "../../tests/unit/seal/refused.rs"]
mod refused;
#[cfg(test)]
#[path = "../../tests/unit/seal/session_tests.rs"]
mod session_tests;
#[cfg(test)]
#[path = "../../tests/unit/seal.rs"]
pub(crate) mod tests;
#[cfg(test)]
#[path = "../../tests/unit/seal/vectors.rs"]
mod vectors;
