//! Messages before sealing and after verification, and the layout of the plaintext: message header,
//! extensions, then the body. All integers are big-endian.

use super::DropReason;
use bytes::Bytes;
use gdp_core::name::Name;
use std::ops::Range;

pub const TIMESTAMP_LEN: usize = 8;
/// Timestamp, encoding and length of extensions.
pub const MESSAGE_HEADER_LEN: usize = TIMESTAMP_LEN + 4;
/// Encoding, length of extensions and length of the body. The bundle has the timestamp.
pub const BUNDLED_HEADER_LEN: usize = 6;
/// The longest origin, in bytes.
pub const MAX_ORIGIN: usize = 64;

const EXTENSION_HEADER_LEN: usize = 4;
/// Bit of the types of extensions that a reader must know.
const CRITICAL: u16 = 0x8000;
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

    /// Returns the length of the data before the body, in a message by itself.
    pub fn preamble_len(&self) -> usize {
        MESSAGE_HEADER_LEN + self.extensions_len()
    }

    /// Returns the length of the message in a bundle, or `None` if it is too long for one.
    pub fn bundled_len(&self) -> Option<usize> {
        u16::try_from(self.body.len()).ok().map(|body| BUNDLED_HEADER_LEN + self.extensions_len() + usize::from(body))
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
        let (timestamp, fields) = bytes.split_at_mut(TIMESTAMP_LEN);
        timestamp.copy_from_slice(&timestamp_ns.to_be_bytes());
        self.write_fields(&[], fields);
        bytes
    }

    /// Appends the message to a bundle. It must have a [`Self::bundled_len`].
    pub fn bundle_into(&self, out: &mut Vec<u8>) {
        let mut bytes = [0u8; MAX_PREAMBLE];
        self.write_fields(&(self.body.len() as u16).to_be_bytes(), &mut bytes);
        out.extend_from_slice(&bytes[..BUNDLED_HEADER_LEN + self.extensions_len()]);
        out.extend_from_slice(self.body);
    }

    /// Writes encoding and length of extensions, then `more`, then the extensions.
    fn write_fields(&self, more: &[u8], out: &mut [u8]) {
        let mut at = 0;
        let mut put = |part: &[u8]| {
            out[at..at + part.len()].copy_from_slice(part);
            at += part.len();
        };
        put(&u16::from(self.encoding).to_be_bytes());
        put(&(self.extensions_len() as u16).to_be_bytes());
        put(more);
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
    }
}

/// The data before the body, and the offsets in the plaintext.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Preamble {
    pub timestamp_ns: u64,
    pub encoding: Encoding,
    pub in_reply_to: Option<MessageId>,
    pub origin: Range<usize>,
    pub latched: Option<Latched>,
    pub service: Option<Name>,
    pub body: Range<usize>,
}

impl Preamble {
    /// Parses the plaintext of a message by itself. Skips extensions of later releases, unless they
    /// are critical.
    pub fn parse(plaintext: &[u8]) -> Result<Self, DropReason> {
        let (&[t0, t1, t2, t3, t4, t5, t6, t7, e0, e1, x0, x1], rest) =
            plaintext.split_first_chunk::<MESSAGE_HEADER_LEN>().ok_or(DropReason::BadMessage)?;
        let extensions = usize::from(u16::from_be_bytes([x0, x1]));
        let body = rest.len().checked_sub(extensions).ok_or(DropReason::BadMessage)?;
        let timestamp_ns = u64::from_be_bytes([t0, t1, t2, t3, t4, t5, t6, t7]);
        let encoding = u16::from_be_bytes([e0, e1]).into();
        Self::with_extensions(timestamp_ns, encoding, plaintext, MESSAGE_HEADER_LEN, extensions, body)
    }

    /// Parses the plaintext of a bundle of `count` messages.
    pub fn parse_bundle(plaintext: &[u8], count: u32) -> Result<Vec<Self>, DropReason> {
        let timestamp = plaintext.first_chunk().ok_or(DropReason::BadMessage)?;
        let (timestamp_ns, mut at) = (u64::from_be_bytes(*timestamp), TIMESTAMP_LEN);
        let mut messages = Vec::with_capacity(count as usize);
        while let Some(&[e0, e1, x0, x1, b0, b1]) = plaintext[at..].first_chunk::<BUNDLED_HEADER_LEN>() {
            let (extensions, body) = (u16::from_be_bytes([x0, x1]).into(), u16::from_be_bytes([b0, b1]).into());
            let encoding = u16::from_be_bytes([e0, e1]).into();
            let from = at + BUNDLED_HEADER_LEN;
            messages.push(Self::with_extensions(timestamp_ns, encoding, plaintext, from, extensions, body)?);
            at = from + extensions + body;
        }
        let is_whole = at == plaintext.len() && messages.len() == count as usize;
        is_whole.then_some(messages).ok_or(DropReason::BadMessage)
    }

    fn with_extensions(
        timestamp_ns: u64,
        encoding: Encoding,
        plaintext: &[u8],
        from: usize,
        extensions: usize,
        body: usize,
    ) -> Result<Self, DropReason> {
        let at = from + extensions;
        if plaintext.len() < at + body {
            return Err(DropReason::BadMessage);
        }
        let mut preamble = Self {
            timestamp_ns,
            encoding,
            in_reply_to: None,
            origin: 0..0,
            latched: None,
            service: None,
            body: at..at + body,
        };
        let mut rest = &plaintext[from..at];
        while !rest.is_empty() {
            let (&[k0, k1, l0, l1], behind) = rest.split_first_chunk().ok_or(DropReason::BadMessage)?;
            let length = u16::from_be_bytes([l0, l1]).into();
            let (value, behind) = behind.split_at_checked(length).ok_or(DropReason::BadMessage)?;
            rest = behind;
            let value_at = at - rest.len() - value.len();
            preamble.extension(u16::from_be_bytes([k0, k1]), value, value_at)?;
        }
        Ok(preamble)
    }

    /// Returns the message as a draft, given the plaintext that it was parsed from.
    pub fn draft<'a>(&self, plaintext: &'a [u8]) -> Draft<'a> {
        let Self { encoding, in_reply_to, origin, latched, service, body, .. } = self;
        Draft {
            encoding: *encoding,
            in_reply_to: *in_reply_to,
            origin: &plaintext[origin.clone()],
            latched: *latched,
            service: *service,
            body: &plaintext[body.clone()],
        }
    }

    /// Parses one extension. A known extension must not be repeated.
    fn extension(&mut self, kind: u16, value: &[u8], at: usize) -> Result<(), DropReason> {
        let is_new = match kind {
            IN_REPLY_TO => self.in_reply_to.is_none() && value.len() == IN_REPLY_TO_LEN,
            ORIGIN => self.origin.is_empty() && (1..=MAX_ORIGIN).contains(&value.len()),
            LATCHED => self.latched.is_none() && value.len() == LATCHED_LEN,
            SERVICE => self.service.is_none() && value.len() == SERVICE_LEN,
            unknown if unknown & CRITICAL != 0 => return Err(DropReason::Unsupported),
            _ => return Ok(()),
        };
        let fields = Fields(value);
        match kind {
            _ if !is_new => return Err(DropReason::BadMessage),
            IN_REPLY_TO => self.in_reply_to = Some(MessageId { session: fields.at(0)?, sequence: fields.number(16)? }),
            ORIGIN => self.origin = at..at + value.len(),
            LATCHED => self.latched = Some(Latched { sequence: fields.number(0)?, timestamp_ns: fields.number(8)? }),
            _ => self.service = Some(Name::from_bytes(fields.at(0)?)),
        }
        Ok(())
    }
}

/// The value of an extension.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn at<const N: usize>(&self, at: usize) -> Result<[u8; N], DropReason> {
        self.0.get(at..).and_then(<[u8]>::first_chunk).copied().ok_or(DropReason::BadMessage)
    }

    fn number(&self, at: usize) -> Result<u64, DropReason> {
        self.at(at).map(u64::from_be_bytes)
    }
}

/// The encoding of a message's body (`docs/wire-format.md`, "Sealed segments").
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
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
