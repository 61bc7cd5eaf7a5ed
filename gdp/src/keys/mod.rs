//! The keys that messages are read with (DESIGN §8). A writer seals what it says of a name under the key of an epoch, and wraps
//! that key to each of its readers: [`KeyRing`] decides when an epoch begins and who gets a [`KeyBox`]; [`KeyStore`] is the
//! reader's side. What only two of them may read ([`crate::feedback_wire`]) goes under a [`PairKey`]. No sockets, no clocks, nothing of nodes: time (nanoseconds since the Unix epoch) and what was received come in.
//! What is sealed under the keys is [`crate::seal`]'s.

mod box_key;
mod key_box;
mod pair;
mod ring;
mod store;

pub use box_key::BoxKey;
pub use key_box::{KeyBox, open, wrap};
pub use pair::{MAX_PAIR_PAYLOAD, PairError, PairKey, PairOpener, PairSealer};
pub use ring::{Boxes, KeyRing, MAX_READERS, Omission, RingError, Rotation};
pub use store::{KeyStore, MAX_WRITERS, Opened, StoreError};

#[cfg(test)]
mod tests;
#[cfg(test)]
mod vectors;
