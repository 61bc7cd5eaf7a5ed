//! Options of a mapping: the limits of a message, and the policy for fields that only one type has.

use std::fmt;

/// What may become of one message.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Options {
    /// Most bytes that a message may take when it is written.
    pub max_output: usize,
    /// `seq` of a header that is a field of the message itself, where ROS 2 has none and ROS 1 has
    /// one. Headers further inside get 0.
    pub header_seq: u32,
}

impl Default for Options {
    fn default() -> Self {
        Self { max_output: 256 << 20, header_seq: 0 }
    }
}

/// A field that only one of the two types has.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Note {
    /// The receiving type has no such field, so what it says is lost.
    Dropped(String),
    /// The sending type has no such field, so it is zero or empty.
    Filled(String),
}

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Dropped(path) => write!(f, "`{path}` is lost: the receiving type has no such field"),
            Self::Filled(path) => write!(f, "`{path}` stays zero or empty: the sending type has no such field"),
        }
    }
}
