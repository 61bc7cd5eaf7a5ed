//! Key expressions of topics and services: `<domain>/<name>/<DDS type>/RIHS01_<hash>`.

use std::fmt;

/// The hash of a type's definition (REP 2016): `RIHS01_` and 64 hexadecimal digits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TypeHash(pub [u8; 32]);

const PREFIX: &str = "RIHS01_";

impl TypeHash {
    /// Reads a hash. Returns `None` if the text is no hash of version 1, as `TypeHashNotSupported`.
    pub fn parse(text: &str) -> Option<Self> {
        let digits = text.strip_prefix(PREFIX)?.as_bytes();
        if digits.len() != 64 {
            return None;
        }
        let digit = |c: u8| match c {
            b'0'..=b'9' => Some(c - b'0'),
            b'a'..=b'f' => Some(c - b'a' + 10),
            _ => None,
        };
        let mut hash = [0; 32];
        for (byte, pair) in hash.iter_mut().zip(digits.chunks_exact(2)) {
            *byte = digit(pair[0])? << 4 | digit(pair[1])?;
        }
        Some(Self(hash))
    }
}

impl fmt::Display for TypeHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(PREFIX)?;
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// Returns the key expression of a topic or service, such as `/chatter` of the DDS type
/// `std_msgs::msg::dds_::String_`.
pub fn topic_key(domain: u32, name: &str, kind: &str, hash: &TypeHash) -> String {
    format!("{domain}/{}/{kind}/{hash}", name.trim_matches('/'))
}

#[cfg(test)]
#[path = "../tests/unit/key.rs"]
mod tests;
