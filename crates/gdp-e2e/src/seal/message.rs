//! Messages before sealing and after verification, and the layout of the plaintext: message header,
//! extensions, then the body. All integers are big-endian.

use bytes::Bytes;
use gdp_core::name::Name;

pub const MESSAGE_HEADER_LEN: usize = 16;
/// The longest origin, in bytes.
pub const MAX_ORIGIN: usize = 64;

const EXTENSION_HEADER_LEN: usize = 4;
const IN_REPLY_TO: u16 = 1;
const IN_REPLY_TO_LEN: usize = 24;
const ORIGIN: u16 = 2;
const LATCHED: u16 = 3;
const LATCHED_LEN: usize = 16;
const SERVICE: u16 = 4;
const SERVICE_LEN: usize = 32;

/// Maximum length of the data before the body, in this version.
pub const MAX_PREAMBLE: usize =
    MESSAGE_HEADER_LEN + 4 * EXTENSION_HEADER_LEN + IN_REPLY_TO_LEN + MAX_ORIGIN + LATCHED_LEN + SERVICE_LEN;

/// A message as its writer signed it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    pub name: Name,
    pub writer: Name,
    pub session: [u8; 16],
    pub sequence: u64,
    /// Unix time on the writer's clock.
    pub timestamp_ns: u64,
    pub encoding: Encoding,
    /// The request that this answers.
    pub in_reply_to: Option<MessageId>,
    /// The origin of the message at a proxy, in the proxies' own format. Empty if the writer did
    /// not state one.
    pub origin: Bytes,
    /// The message was sent before, and is repeated for readers that joined later.
    pub latched: Option<Latched>,
    /// The service of a request. Such a message is sent to the name of one of the service's
    /// servers.
    pub service: Option<Name>,
    pub body: Bytes,
}

/// The identity of a message when it was first sent, in the same session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Latched {
    pub sequence: u64,
    /// Unix time on the writer's clock.
    pub timestamp_ns: u64,
}

/// Identifies a message of a writer by session and sequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct MessageId {
    pub session: [u8; 16],
    pub sequence: u64,
}

/// A message to be sealed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Draft<'a> {
    pub encoding: Encoding,
    pub in_reply_to: Option<MessageId>,
    /// At most [`MAX_ORIGIN`] bytes; empty for none.
    pub origin: &'a [u8],
    pub latched: Option<Latched>,
    pub service: Option<Name>,
    pub body: &'a [u8],
}

impl<'a> Draft<'a> {
    /// Returns a draft without extensions.
    pub fn new(encoding: Encoding, body: &'a [u8]) -> Self {
        Self { encoding, in_reply_to: None, origin: &[], latched: None, service: None, body }
    }

    /// Returns the length of the data before the body.
    pub fn preamble_len(&self) -> usize {
        MESSAGE_HEADER_LEN + self.extensions_len()
    }

    fn extensions_len(&self) -> usize {
        let in_reply_to = self.in_reply_to.map_or(0, |_| EXTENSION_HEADER_LEN + IN_REPLY_TO_LEN);
        let origin = if self.origin.is_empty() { 0 } else { EXTENSION_HEADER_LEN + self.origin.len() };
        let latched = self.latched.map_or(0, |_| EXTENSION_HEADER_LEN + LATCHED_LEN);
        let service = self.service.map_or(0, |_| EXTENSION_HEADER_LEN + SERVICE_LEN);
        in_reply_to + origin + latched + service
    }

    /// Returns the data before the body, in the first [`Self::preamble_len`] bytes. The length of
    /// the origin must have been checked.
    pub fn preamble(&self, timestamp_ns: u64) -> [u8; MAX_PREAMBLE] {
        let mut bytes = [0u8; MAX_PREAMBLE];
        let mut at = 0;
        let mut put = |part: &[u8]| {
            bytes[at..at + part.len()].copy_from_slice(part);
            at += part.len();
        };
        put(&timestamp_ns.to_be_bytes());
        put(&u16::from(self.encoding).to_be_bytes());
        put(&(self.extensions_len() as u16).to_be_bytes());
        put(&[0; 4]);
        if let Some(request) = self.in_reply_to {
            put(&IN_REPLY_TO.to_be_bytes());
            put(&(IN_REPLY_TO_LEN as u16).to_be_bytes());
            put(&request.session);
            put(&request.sequence.to_be_bytes());
        }
        if !self.origin.is_empty() {
            put(&ORIGIN.to_be_bytes());
            put(&(self.origin.len() as u16).to_be_bytes());
            put(self.origin);
        }
        if let Some(first) = self.latched {
            put(&LATCHED.to_be_bytes());
            put(&(LATCHED_LEN as u16).to_be_bytes());
            put(&first.sequence.to_be_bytes());
            put(&first.timestamp_ns.to_be_bytes());
        }
        if let Some(service) = &self.service {
            put(&SERVICE.to_be_bytes());
            put(&(SERVICE_LEN as u16).to_be_bytes());
            put(service.as_bytes());
        }
        bytes
    }
}

/// The data before the body, and the offsets in the plaintext.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Preamble {
    pub timestamp_ns: u64,
    pub encoding: Encoding,
    pub in_reply_to: Option<MessageId>,
    pub origin: std::ops::Range<usize>,
    pub latched: Option<Latched>,
    pub service: Option<Name>,
    pub body_at: usize,
}

impl Preamble {
    /// Returns `None` if the plaintext is malformed. Skips extensions of later versions.
    pub fn parse(plaintext: &[u8]) -> Option<Self> {
        let (bytes, rest) = plaintext.split_first_chunk::<MESSAGE_HEADER_LEN>()?;
        let [t0, t1, t2, t3, t4, t5, t6, t7, e0, e1, x0, x1, reserved @ ..] = *bytes;
        let extensions = rest.get(..usize::from(u16::from_be_bytes([x0, x1])))?;
        if reserved != [0; 4] {
            return None;
        }
        let mut preamble = Self {
            timestamp_ns: u64::from_be_bytes([t0, t1, t2, t3, t4, t5, t6, t7]),
            encoding: u16::from_be_bytes([e0, e1]).into(),
            in_reply_to: None,
            origin: 0..0,
            latched: None,
            service: None,
            body_at: MESSAGE_HEADER_LEN + extensions.len(),
        };
        let mut rest = extensions;
        while !rest.is_empty() {
            let (&[k0, k1, l0, l1], behind) = rest.split_first_chunk::<EXTENSION_HEADER_LEN>()?;
            let (value, behind) = behind.split_at_checked(u16::from_be_bytes([l0, l1]).into())?;
            rest = behind;
            let value_at = preamble.body_at - rest.len() - value.len();
            preamble.extension(u16::from_be_bytes([k0, k1]), value, value_at)?;
        }
        Some(preamble)
    }

    /// Returns the message as a draft, given the plaintext that it was parsed from.
    pub fn draft<'a>(&self, plaintext: &'a [u8]) -> Draft<'a> {
        let Self { encoding, in_reply_to, origin, latched, service, body_at, .. } = self;
        Draft {
            encoding: *encoding,
            in_reply_to: *in_reply_to,
            origin: &plaintext[origin.clone()],
            latched: *latched,
            service: *service,
            body: &plaintext[*body_at..],
        }
    }

    /// Parses one extension. A known extension must not be repeated.
    fn extension(&mut self, kind: u16, value: &[u8], at: usize) -> Option<()> {
        match kind {
            IN_REPLY_TO if self.in_reply_to.is_none() && value.len() == IN_REPLY_TO_LEN => {
                let (session, sequence) = value.split_first_chunk::<16>()?;
                let sequence = u64::from_be_bytes(sequence.try_into().ok()?);
                self.in_reply_to = Some(MessageId { session: *session, sequence });
            }
            ORIGIN if self.origin.is_empty() && (1..=MAX_ORIGIN).contains(&value.len()) => {
                self.origin = at..at + value.len();
            }
            LATCHED if self.latched.is_none() && value.len() == LATCHED_LEN => {
                let (sequence, timestamp) = value.split_first_chunk::<8>()?;
                let timestamp_ns = u64::from_be_bytes(timestamp.try_into().ok()?);
                self.latched = Some(Latched { sequence: u64::from_be_bytes(*sequence), timestamp_ns });
            }
            SERVICE if self.service.is_none() && value.len() == SERVICE_LEN => {
                self.service = Some(Name::from_bytes(value.try_into().ok()?));
            }
            IN_REPLY_TO | ORIGIN | LATCHED | SERVICE => return None,
            _ => {}
        }
        Some(())
    }
}

/// The encoding of a message's body (`docs/wire-format.md`, "Sealed segments").
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Encoding {
    /// Application-specific bytes.
    Bytes,
    Json,
    Cdr,
    Ros1,
    /// An encoding of a later version, or for private use.
    Other(u16),
}

impl From<Encoding> for u16 {
    fn from(encoding: Encoding) -> Self {
        match encoding {
            Encoding::Bytes => 0,
            Encoding::Json => 1,
            Encoding::Cdr => 2,
            Encoding::Ros1 => 3,
            Encoding::Other(code) => code,
        }
    }
}

impl From<u16> for Encoding {
    fn from(code: u16) -> Self {
        match code {
            0 => Self::Bytes,
            1 => Self::Json,
            2 => Self::Cdr,
            3 => Self::Ros1,
            code => Self::Other(code),
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/seal/message.rs"]
mod tests;
