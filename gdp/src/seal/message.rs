//! What a message is before it is sealed and after it was verified, and how its plaintext begins: message header,
//! extensions, then the body. All integers are big-endian.

use crate::name::Name;
use bytes::Bytes;

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

/// What is in front of the body at most, by this version.
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
    /// Where a proxy had it from, as proxies understand it. Empty if the writer did not say.
    pub origin: Bytes,
    /// Sent before, and again for readers that came later.
    pub latched: Option<Latched>,
    /// The service that this is a request to; such a message is sent to one of its servers by that entity's own name.
    pub service: Option<Name>,
    pub body: Bytes,
}

/// What a message was when it was sent first, in the same session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Latched {
    pub sequence: u64,
    /// Unix time on the writer's clock.
    pub timestamp_ns: u64,
}

/// A message of some writer, by session and sequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct MessageId {
    pub session: [u8; 16],
    pub sequence: u64,
}

/// A message that is to be sealed.
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
    /// Without extensions.
    pub fn new(encoding: Encoding, body: &'a [u8]) -> Self {
        Self { encoding, in_reply_to: None, origin: &[], latched: None, service: None, body }
    }

    /// Bytes of what is in front of the body.
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

    /// What is in front of the body; the first [`Self::preamble_len`] bytes count. The origin has been checked.
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

/// What is in front of the body, and where things are in the plaintext.
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
    /// `None` if it makes no sense. Extensions of later versions are skipped.
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

    /// The message again, given the plaintext that this was parsed from.
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

    /// One extension; those that are known come once.
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

/// How the body of a message is encoded (DESIGN §10).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Encoding {
    /// Bytes that only the application understands.
    Bytes,
    Json,
    Cdr,
    Ros1,
    /// Of a later version, or private use.
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
mod tests {
    use super::*;

    const REQUEST: MessageId = MessageId { session: [7; 16], sequence: 9 };

    #[test]
    fn what_is_in_front_of_the_body_round_trips() {
        let latched = Some(Latched { sequence: 4, timestamp_ns: 2 });
        let plain = Draft::new(Encoding::Cdr, b"");
        let service = Some(Name::from_bytes([6; 32]));
        let full = Draft { in_reply_to: Some(REQUEST), origin: &[5; MAX_ORIGIN], latched, service, ..plain };
        for draft in [
            full,
            Draft { in_reply_to: None, ..full },
            Draft { service: None, ..full },
            Draft { origin: b"", ..full },
            Draft { origin: b"x", latched: None, ..full },
        ] {
            let mut plaintext = draft.preamble(3)[..draft.preamble_len()].to_vec();
            plaintext.extend(b"body");
            let preamble = Preamble::parse(&plaintext).unwrap();
            assert_eq!((preamble.timestamp_ns, preamble.encoding), (3, Encoding::Cdr));
            assert_eq!((preamble.in_reply_to, &plaintext[preamble.origin]), (draft.in_reply_to, draft.origin));
            assert_eq!((preamble.latched, preamble.service), (draft.latched, draft.service));
            assert_eq!(&plaintext[preamble.body_at..], b"body");
        }
        assert_eq!(full.preamble_len(), MAX_PREAMBLE);
    }

    #[test]
    fn extensions_of_later_versions_are_skipped() {
        let plaintext = with_extensions(&[&[0x7f, 0xff, 0, 3, 1, 2, 3], &[0, 2, 0, 1, 9], &[0, 0, 0, 0]]);
        let preamble = Preamble::parse(&plaintext).unwrap();
        assert_eq!((&plaintext[preamble.origin], &plaintext[preamble.body_at..]), (&[9][..], &b"body"[..]));
    }

    #[test]
    fn extensions_that_make_no_sense_are_refused() {
        let reply = |len: usize| [&[0, 1, 0, len as u8][..], &[0; 24][..len.min(24)]].concat();
        let latched = |len: usize| [&[0, 3, 0, len as u8][..], &[0; 16][..len]].concat();
        let service = |len: usize| [&[0, 4, 0, len as u8][..], &[0; 33][..len]].concat();
        let (service, short_service, long_service) = (service(32), service(31), service(33));
        let (latched, short_latched) = (latched(16), latched(15));
        let (reply, short, origin) = (reply(24), reply(23), [0, 2, 0, 1, 9]);
        let long_origin = [&[0, 2, 0, 65][..], &[9; 65]].concat();
        for (what, extensions) in [
            ("a value that ends behind the extensions", vec![&[0x7f, 0, 0, 1][..]]),
            ("half a header", vec![&[0, 2, 0]]),
            ("a short identifier", vec![&short]),
            ("two requests", vec![&reply, &reply]),
            ("an empty origin", vec![&[0, 2, 0, 0]]),
            ("a long origin", vec![&long_origin]),
            ("two origins", vec![&origin, &origin]),
            ("half a first sending", vec![&short_latched]),
            ("two first sendings", vec![&latched, &latched]),
            ("a short service", vec![&short_service]),
            ("a long service", vec![&long_service]),
            ("two services", vec![&service, &service]),
        ] {
            assert_eq!(Preamble::parse(&with_extensions(&extensions)), None, "{what}");
        }
        let mut plaintext = with_extensions(&[&reply]);
        assert!(Preamble::parse(&plaintext).is_some());
        assert!((0..MESSAGE_HEADER_LEN + 28).all(|len| Preamble::parse(&plaintext[..len]).is_none()));
        plaintext[15] = 1;
        assert_eq!(Preamble::parse(&plaintext), None, "reserved bytes");
    }

    fn with_extensions(extensions: &[&[u8]]) -> Vec<u8> {
        let extensions = extensions.concat();
        let mut plaintext = Draft::new(Encoding::Bytes, b"").preamble(0)[..MESSAGE_HEADER_LEN].to_vec();
        plaintext[10..12].copy_from_slice(&(extensions.len() as u16).to_be_bytes());
        [&plaintext[..], &extensions, b"body"].concat()
    }
}
