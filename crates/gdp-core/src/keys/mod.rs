//! Keys that encrypt messages, and their wrapping for each reader (HPKE, RFC 9180).

mod box_key;
mod epoch_key;
mod key_box;

pub use box_key::BoxKey;
pub use epoch_key::{EpochKey, SessionKey};
pub use key_box::{KeyBox, open, wrap};
