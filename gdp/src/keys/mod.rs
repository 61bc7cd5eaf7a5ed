//! Content keys.

mod key_box;

pub use key_box::KeyBox;
