//! The connection header. It is a list of fields `name=value`, each with a length prefix, and a
//! length prefix for the whole. Lengths are 32-bit little-endian.
//! <https://wiki.ros.org/ROS/Connection%20Header>

use std::collections::BTreeMap;

/// Maximum size of a header without its length prefix, in bytes. A publisher's header contains the
/// message definition.
pub const MAX_HEADER: usize = 1 << 20;

/// Maximum number of fields in a header. A dozen are standard.
pub const MAX_FIELDS: usize = 64;

/// The connection header, which two peers exchange before the first message.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Header(BTreeMap<String, String>);

/// The reason why bytes are not a connection header.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HeaderError {
    #[error("a header of {0} bytes: at most {MAX_HEADER} are taken")]
    TooLong(u32),
    #[error("a field ends after the header")]
    Truncated,
    #[error("a field without '='")]
    NoValue,
    #[error("the name of a field is not UTF-8")]
    NotText,
    #[error("the field {0:?} twice")]
    Twice(String),
    #[error("more than {MAX_FIELDS} fields")]
    TooMany,
}

impl Header {
    pub fn new<'a>(fields: impl IntoIterator<Item = (&'a str, &'a str)>) -> Self {
        Self(fields.into_iter().map(|(name, value)| (name.to_owned(), value.to_owned())).collect())
    }

    pub fn get(&self, name: &str) -> Option<&str> {
        self.0.get(name).map(String::as_str)
    }

    /// Returns whether a field has the value `1`, which means true in ROS.
    pub fn is_set(&self, name: &str) -> bool {
        self.get(name) == Some("1")
    }

    /// Encodes the header with its length prefix.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = vec![0; 4];
        for (name, value) in &self.0 {
            bytes.extend(((name.len() + 1 + value.len()) as u32).to_le_bytes());
            bytes.extend(name.as_bytes());
            bytes.push(b'=');
            bytes.extend(value.as_bytes());
        }
        let length = (bytes.len() - 4) as u32;
        bytes[..4].copy_from_slice(&length.to_le_bytes());
        bytes
    }

    /// Decodes a header without its length prefix.
    pub fn decode(mut bytes: &[u8]) -> Result<Self, HeaderError> {
        if bytes.len() > MAX_HEADER {
            return Err(HeaderError::TooLong(bytes.len() as u32));
        }
        let mut fields = BTreeMap::new();
        while !bytes.is_empty() {
            let (length, rest) = bytes.split_first_chunk().ok_or(HeaderError::Truncated)?;
            let length = u32::from_le_bytes(*length) as usize;
            let (field, rest) = rest.split_at_checked(length).ok_or(HeaderError::Truncated)?;
            let equals = field.iter().position(|&byte| byte == b'=').ok_or(HeaderError::NoValue)?;
            let name = std::str::from_utf8(&field[..equals]).map_err(|_| HeaderError::NotText)?;
            // Some message definitions have comments in Latin-1.
            let value = String::from_utf8_lossy(&field[equals + 1..]);
            if fields.len() == MAX_FIELDS {
                return Err(HeaderError::TooMany);
            }
            if fields.insert(name.to_owned(), value.into_owned()).is_some() {
                return Err(HeaderError::Twice(name.chars().take(32).collect()));
            }
            bytes = rest;
        }
        Ok(Self(fields))
    }
}

#[cfg(test)]
#[path = "../../tests/unit/tcpros/header.rs"]
mod tests;
