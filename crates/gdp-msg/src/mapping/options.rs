//! Options of transcoding, and the notes about fields that only one type has.

use std::fmt;

/// Options for transcoding one message.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Options {
    /// Maximum size of the written message, in bytes.
    pub max_output: usize,
    /// The `seq` of the message's own header field, from ROS 2 to ROS 1. Nested headers get 0.
    pub header_seq: u32,
}

impl Default for Options {
    fn default() -> Self {
        Self { max_output: 256 << 20, header_seq: 0 }
    }
}

/// A note about a field that only one of the two types has.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Note {
    /// The receiving type lacks this field, so its value is lost.
    Dropped(String),
    /// The sending type lacks this field, so its value is zero or empty.
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
