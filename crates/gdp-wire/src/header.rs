//! The headers of frames. Every frame begins with the same eight bytes; see `docs/wire-format.md`.

use core::mem::{offset_of, size_of};

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use crate::Name;
use crate::siphash::siphash24;

/// The protocol version of forwarded frames, errors and echoes, in the high four bits of the first
/// byte.
pub const VERSION: u8 = 2;

/// The version of control frames. It is that of the oldest release: QUIC negotiates the version of
/// a link, and the two ends must be able to exchange its packets to refuse each other with a
/// reason.
pub const CONTROL_VERSION: u8 = 1;

/// First byte above those of GDP frames on a shared UDP port: this and all larger ones are QUIC.
pub const FIRST_QUIC_BYTE: u8 = 0x40;

/// The hop limit of a frame when its writer sends it.
pub const INITIAL_HOP_LIMIT: u8 = 64;

/// The type of a frame: the low four bits of the first byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum FrameType {
    /// Sealed segments, forwarded by name.
    Data = 0,
    /// QUIC (and the discovery that precedes it) on Ethernet; never forwarded.
    Control = 1,
    /// Reports the reason of a drop to the neighbour that sent the frame; never forwarded.
    Error = 2,
    /// Asks the switch where the probe ends for its identity; forwarded by its egress bit.
    Probe = 3,
    /// A liveness check of the neighbour's data plane, or the answer to one; never forwarded.
    Echo = 4,
}

/// The reason of an error: [`Header::egress_set`] of an error frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum ErrorCode {
    /// The name is unknown, or has no readers.
    NoRoute = 1,
    /// The frame is larger than the MTU of the next link.
    TooBig = 2,
    /// The hop limit is used up.
    HopLimit = 3,
    /// The link may not send to this name.
    NotAuthorised = 4,
}

impl ErrorCode {
    /// Number of codes.
    pub const COUNT: usize = Self::ALL.len();

    /// All codes in numerical order, from 1.
    pub const ALL: [Self; 4] = [Self::NoRoute, Self::TooBig, Self::HopLimit, Self::NotAuthorised];

    /// Returns the index in [`Self::ALL`].
    pub const fn index(self) -> usize {
        self as usize - 1
    }

    /// Returns the name of the code in statistics.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::NoRoute => "no_route",
            Self::TooBig => "too_big",
            Self::HopLimit => "hop_limit",
            Self::NotAuthorised => "not_authorised",
        }
    }

    /// Returns the code with this number.
    pub const fn from_number(number: u8) -> Option<Self> {
        match number {
            1 => Some(Self::NoRoute),
            2 => Some(Self::TooBig),
            3 => Some(Self::HopLimit),
            4 => Some(Self::NotAuthorised),
            _ => None,
        }
    }
}

impl FrameType {
    /// Returns the first byte of a frame of this type.
    #[inline(always)]
    pub const fn first_byte(self) -> u8 {
        let version = if matches!(self, Self::Control) { CONTROL_VERSION } else { VERSION };
        version << 4 | self as u8
    }
}

/// The fixed header of a forwarded frame: 96 bytes, all integers big-endian on the wire.
///
/// The fields have the alignment of a frame behind an Ethernet header in the kernel. The eBPF
/// program can therefore use the header without copying it. On the host, copy the header out with
/// [`FromBytes::read_from_bytes`].
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, FromBytes, IntoBytes, KnownLayout, Immutable)]
#[repr(C)]
pub struct Header {
    /// [`VERSION`] (high 4 bits) and [`FrameType`] (low 4 bits).
    pub version_type: u8,
    /// [`Header::KEY_PHASE`], [`Header::FOREIGN`], a reserved flag, traffic class (3 bits), ECN (2
    /// bits).
    pub flags: u8,
    /// Number of switches that the frame may still cross. A switch drops a frame that arrives with
    /// 0 or 1.
    pub hop_limit: u8,
    /// The set of 64 egress switches that `egress_bits` refers to. In an error, its [`ErrorCode`];
    /// in an echo, [`Header::ASKS`] or [`Header::ANSWERS`].
    pub egress_set: u8,
    payload_len: u16,
    /// Header length in units of 8 bytes: 12.
    pub header_words: u8,
    /// Zero.
    pub reserved: u8,
    link_id: u32,
    link_counter: u32,
    tag: u64,
    egress_bits: u64,
    /// Destination of the frame: the name of a topic.
    pub destination: Name,
    /// Writer of the frame: the name of an entity.
    pub source: Name,
}

impl Header {
    /// Bytes of the header on the wire.
    pub const LEN: usize = 96;
    /// Byte range of the hop tag in the header.
    pub const TAG: core::ops::Range<usize> = 16..24;
    /// Number of words that the hop tag covers.
    pub const TAGGED_WORDS: usize = 7;

    /// Flag: the key phase of the tag, one of the two link keys that are valid at a time.
    pub const KEY_PHASE: u8 = 0x80;

    /// Flag: the frame came into this domain from another one, so it must not leave for a third.
    pub const FOREIGN: u8 = 0x40;

    /// Flags: the ECN code point of RFC 3168. 0: the writer of the frame does not support marks
    /// (Not-ECT).
    pub const ECN: u8 = 0x03;

    /// Code point: the frame experienced congestion (CE).
    pub const CONGESTED: u8 = 0x03;

    /// [`Header::egress_set`] of an echo that requests an answer.
    pub const ASKS: u8 = 0;

    /// [`Header::egress_set`] of the answer to an echo.
    pub const ANSWERS: u8 = 1;

    /// Returns an echo that requests an answer with the same `cookie`, without the fields of a
    /// link.
    pub fn echo(cookie: u64) -> Self {
        Self {
            version_type: FrameType::Echo.first_byte(),
            hop_limit: 1,
            egress_set: Self::ASKS,
            header_words: (Self::LEN / 8) as u8,
            egress_bits: cookie.to_be(),
            ..Self::default()
        }
    }

    /// Returns a probe without the fields of a link. `source` is the sending switch, and `bit` (0
    /// … 63) the egress switch of the name that the probe is for. The probe ends at that switch,
    /// or at the switch where it arrives with `hop_limit` 1.
    pub fn probe(destination: Name, source: Name, bit: u8, hop_limit: u8) -> Self {
        Self {
            version_type: FrameType::Probe.first_byte(),
            hop_limit,
            egress_bits: (1u64 << (bit & 63)).to_be(),
            ..Self::data(destination, source, Self::COOKIE_LEN as u16)
        }
    }

    /// Bytes of the payload of a probe, which the answer repeats.
    pub const COOKIE_LEN: usize = 8;

    /// Turns an echo that requests an answer into the answer. The answer has no payload, so it is
    /// never larger than the request.
    #[inline(always)]
    pub fn become_answer(&mut self) {
        self.flags &= !Self::ECN;
        self.egress_set = Self::ANSWERS;
        self.payload_len = 0;
    }

    /// Turns a dropped frame into the error with this reason. `mtu` is that of the link that the
    /// frame did not fit, otherwise 0.
    #[inline(always)]
    pub fn become_error(&mut self, code: ErrorCode, mtu: u32) {
        self.version_type = FrameType::Error.first_byte();
        self.flags &= !(Self::FOREIGN | Self::ECN);
        self.hop_limit = 1;
        self.egress_set = code as u8;
        self.payload_len = 0;
        self.reserved = 0;
        self.egress_bits = (u64::from(mtu) << 32 | u64::from(self.link_counter())).to_be();
    }

    /// Returns the contents of an error: its MTU, and the low 32 bits of the count of the frame
    /// that caused it.
    pub fn complaint(&self) -> (u32, u32) {
        let both = self.egress_bits();
        ((both >> 32) as u32, both as u32)
    }

    /// Returns a data frame from `source` to `destination` as its writer makes it, without the
    /// fields of a link.
    #[inline(always)]
    pub fn data(destination: Name, source: Name, payload_len: u16) -> Self {
        Self {
            version_type: FrameType::Data.first_byte(),
            hop_limit: INITIAL_HOP_LIMIT,
            payload_len: payload_len.to_be(),
            header_words: (Self::LEN / 8) as u8,
            destination,
            source,
            ..Self::default()
        }
    }

    /// Returns the DSCP and ECN byte of the IP header that carries a frame with these flags. DSCP
    /// is the class selector of the traffic class (RFC 2474), ECN the code point (RFC 6040, normal
    /// mode).
    #[inline(always)]
    pub const fn ip_traffic(flags: u8) -> u8 {
        (flags & 0x1c) << 3 | flags & Self::ECN
    }

    /// Returns the payload length in bytes.
    #[inline(always)]
    pub fn payload_len(&self) -> u16 {
        u16::from_be(self.payload_len)
    }

    /// Returns the length of header and payload in bytes. Any further bytes are not part of the
    /// frame.
    #[inline(always)]
    pub fn frame_len(&self) -> usize {
        Self::LEN + self.payload_len() as usize
    }

    /// Returns the receiver's id of the frame's link.
    #[inline(always)]
    pub fn link_id(&self) -> u32 {
        u32::from_be(self.link_id)
    }

    #[inline(always)]
    pub fn set_link_id(&mut self, id: u32) {
        self.link_id = id.to_be();
    }

    /// Returns the low 32 bits of the sender's count of frames on this link. See [`crate::replay`]
    /// for the high bits.
    #[inline(always)]
    pub fn link_counter(&self) -> u32 {
        u32::from_be(self.link_counter)
    }

    #[inline(always)]
    pub fn set_link_counter(&mut self, counter: u32) {
        self.link_counter = counter.to_be();
    }

    /// Returns the egress switches of the domain that still need a copy. Bit `i` is switch `i` of
    /// the egress set.
    #[inline(always)]
    pub fn egress_bits(&self) -> u64 {
        u64::from_be(self.egress_bits)
    }

    #[inline(always)]
    pub fn set_egress_bits(&mut self, bits: u64) {
        self.egress_bits = bits.to_be();
    }

    /// Returns the hop tag as on the wire.
    #[inline(always)]
    pub fn tag(&self) -> u64 {
        u64::from_be(self.tag)
    }

    #[inline(always)]
    pub fn set_tag(&mut self, tag: u64) {
        self.tag = tag.to_be();
    }

    /// Returns the hop tag of this header under a key of its link, for the whole count of the
    /// frame.
    #[inline(always)]
    pub fn tag_for(&self, key: [u64; 2], count: u64) -> u64 {
        siphash24(key, &self.tagged_words(count))
    }

    /// Returns the little-endian words that the hop tag covers: the header up to the source,
    /// without the tag, and the high 32 bits of the link's count. Those bits are not in the header.
    /// They are XORed onto the link id, which is constant under a key. `docs/security.md` states
    /// who checks the source.
    #[inline(always)]
    pub fn tagged_words(&self, count: u64) -> [u64; Self::TAGGED_WORDS] {
        let link = self.word(1) ^ u64::from(((count >> 32) as u32).swap_bytes());
        [self.word(0), link, self.word(3), self.word(4), self.word(5), self.word(6), self.word(7)]
    }

    /// Returns a word of the header; `i` is below 12.
    #[inline(always)]
    fn word(&self, i: usize) -> u64 {
        let this = (&raw const *self).cast::<u64>();
        // SAFETY: `Header` is 96 bytes of plain data with the alignment of u64, which is twelve
        // words.
        u64::from_le(unsafe { this.add(i).read() })
    }
}

/// The header of a control frame, which carries QUIC directly on Ethernet. Ethernet pads short
/// frames, so the header contains the payload length.
#[derive(Clone, Copy, PartialEq, Eq, Debug, FromBytes, IntoBytes, KnownLayout, Immutable)]
#[repr(C)]
pub struct ControlHeader {
    pub version_type: u8,
    /// One of [`ControlHeader::QUIC`], [`ControlHeader::SOLICIT`], [`ControlHeader::ANSWER`].
    pub kind: u8,
    pub zero: [u8; 2],
    payload_len: [u8; 2],
    /// Header length in units of 8 bytes: 1.
    pub header_words: u8,
    pub reserved: u8,
}

impl ControlHeader {
    /// Bytes of the header on the wire.
    pub const LEN: usize = 8;
    /// The payload is one QUIC packet (or several coalesced).
    pub const QUIC: u8 = 0;
    /// Requests the identity of the switch on this segment. No payload; sent to the broadcast
    /// address.
    pub const SOLICIT: u8 = 0x80;
    /// The answer to a solicitation. The payload is the 32-byte name of the switch, which TLS then
    /// proves.
    pub const ANSWER: u8 = 0x40;

    pub fn new(kind: u8, payload_len: u16) -> Self {
        Self {
            version_type: FrameType::Control.first_byte(),
            kind,
            zero: [0; 2],
            payload_len: payload_len.to_be_bytes(),
            header_words: (Self::LEN / 8) as u8,
            reserved: 0,
        }
    }

    /// Returns the kind and payload of a control frame, without padding, or `None` if the frame is
    /// not one.
    pub fn parse(frame: &[u8]) -> Option<(u8, &[u8])> {
        let (header, rest) = Self::read_from_prefix(frame).ok()?;
        if header.version_type != FrameType::Control.first_byte() || usize::from(header.header_words) * 8 != Self::LEN {
            return None;
        }
        Some((header.kind, rest.get(..u16::from_be_bytes(header.payload_len).into())?))
    }
}

const _: () = {
    assert!(size_of::<Header>() == Header::LEN && align_of::<Header>() == 8);
    assert!(offset_of!(Header, payload_len) == 4);
    assert!(offset_of!(Header, link_id) == 8);
    assert!(offset_of!(Header, link_counter) == 12);
    assert!(offset_of!(Header, tag) == 16);
    assert!(offset_of!(Header, egress_bits) == 24);
    assert!(offset_of!(Header, destination) == 32);
    assert!(offset_of!(Header, source) == 64);
    assert!(size_of::<ControlHeader>() == ControlHeader::LEN && align_of::<ControlHeader>() == 1);
};

#[cfg(test)]
#[path = "../tests/unit/header.rs"]
mod tests;
