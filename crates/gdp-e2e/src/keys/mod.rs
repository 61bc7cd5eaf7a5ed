//! The content keys of writers and readers (`docs/architecture.md`, "A message").
//!
//! A writer seals its messages of a name under the key of an epoch, and wraps that key for each of
//! its readers. [`KeyRing`] decides when an epoch begins and who gets a [`KeyBox`]. [`KeyStore`] is
//! the reader's side. Feedback between two entities ([`crate::feedback_wire`]) is sealed under a
//! [`PairKey`]. The module has no sockets, clocks or nodes: callers pass in the time (nanoseconds
//! since the Unix epoch) and received bytes. [`crate::seal`] seals with these keys.

mod pair;
mod ring;
mod store;

pub use pair::{MAX_PAIR_PAYLOAD, PairError, PairKey, PairOpener, PairSealer, VERSION as PAIR_VERSION};
pub use ring::{Boxes, KeyRing, MAX_READERS, Omission, RingError, Rotation};
pub use store::{KeyStore, MAX_WRITERS, Opened, StoreError};

#[cfg(test)]
#[path = "../../tests/unit/keys.rs"]
mod tests;
#[cfg(test)]
#[path = "../../tests/unit/keys/vectors.rs"]
mod vectors;
