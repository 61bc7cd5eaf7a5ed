//! The attachment of every message, request and reply: 33 bytes.
//!
//! ```text
//! sequence number (8) │ source time in Unix nanoseconds (8) │ 0x10 │ GID (16)
//! ```
//!
//! Numbers are signed and little-endian. A shorter attachment aborts a process with rmw_zenoh_cpp,
//! so a bridge always writes its own.

use crate::token::Gid;

/// Length of an attachment in bytes.
pub const LENGTH: usize = 33;

/// What a message, request or reply says of its origin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attachment {
    /// The number of the message of this publisher or client, from 1.
    pub sequence: i64,
    /// Time of the write on the publisher's clock in Unix nanoseconds.
    pub time_ns: i64,
    /// The publisher, or the client of a request and of its reply.
    pub gid: Gid,
}

/// An attachment that is not in the form of rmw_zenoh.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AttachmentError {
    #[error("it has no attachment")]
    Missing,
    #[error("its attachment has {0} bytes, and not {LENGTH}")]
    Length(usize),
    #[error("its attachment says that the GID has {0} bytes, and not 16")]
    Gid(u8),
}

impl Attachment {
    /// Reads an attachment, which may be hostile.
    pub fn parse(bytes: &[u8]) -> Result<Self, AttachmentError> {
        let bytes: &[u8; LENGTH] = bytes.try_into().map_err(|_| AttachmentError::Length(bytes.len()))?;
        let number = |at: usize| i64::from_le_bytes(std::array::from_fn(|i| bytes[at + i]));
        match bytes[16] {
            0x10 => Ok(Self { sequence: number(0), time_ns: number(8), gid: std::array::from_fn(|i| bytes[17 + i]) }),
            other => Err(AttachmentError::Gid(other)),
        }
    }

    pub fn to_bytes(&self) -> [u8; LENGTH] {
        let mut bytes = [0; LENGTH];
        bytes[..8].copy_from_slice(&self.sequence.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.time_ns.to_le_bytes());
        bytes[16] = 0x10;
        bytes[17..].copy_from_slice(&self.gid);
        bytes
    }
}

#[cfg(test)]
#[path = "../tests/unit/attachment.rs"]
mod tests;
