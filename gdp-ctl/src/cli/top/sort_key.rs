//! What topics are sorted by: an option, and a key of the keyboard.

use clap::ValueEnum;

/// What topics are sorted by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SortKey {
    Messages,
    Bytes,
    Lost,
    Age,
    Name,
}

impl SortKey {
    /// Returns what a key of the keyboard selects.
    pub fn of(key: char) -> Option<Self> {
        match key {
            'm' => Some(Self::Messages),
            'b' => Some(Self::Bytes),
            'l' => Some(Self::Lost),
            'a' => Some(Self::Age),
            'n' => Some(Self::Name),
            _ => None,
        }
    }
}
