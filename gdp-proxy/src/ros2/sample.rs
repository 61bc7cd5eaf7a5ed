//! A message as bytes, and the adapters through which RustDDS gives and takes it without knowledge
//! of its type.

use std::convert::Infallible;

use bytes::Bytes;
use rustdds::RepresentationIdentifier;
use rustdds::dds::adapters::no_key::{Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter};

/// Bytes of the encapsulation header: representation (2), options (2).
pub const ENCAPSULATION: usize = 4;

/// One message in its wire format.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawSample {
    pub representation: Representation,
    /// Encapsulation header and body. DDS vendors pad the body to a multiple of four.
    pub bytes: Bytes,
}

/// The encodings that ROS 2 uses: XCDR version 1, either byte order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Representation {
    CdrBe,
    CdrLe,
}

impl Representation {
    const fn header(self) -> [u8; ENCAPSULATION] {
        match self {
            Self::CdrBe => [0, 0, 0, 0],
            Self::CdrLe => [0, 1, 0, 0],
        }
    }
}

impl RawSample {
    /// Parses a message of another proxy. Returns `None` if the bytes are not a CDR encapsulation
    /// that DDS could write.
    pub fn parse(bytes: Bytes) -> Option<Self> {
        let representation = match bytes.get(..ENCAPSULATION)? {
            [0, 0, ..] => Representation::CdrBe,
            [0, 1, ..] => Representation::CdrLe,
            _ => return None,
        };
        Some(Self { representation, bytes })
    }
}

/// Receives bytes from RustDDS, which removes their encapsulation header.
pub(super) struct Adapter;

/// Copies a message and restores its header.
#[derive(Clone)]
pub(super) struct Decoder;

impl DeserializerAdapter<RawSample> for Adapter {
    type Error = Infallible;
    type Decoded = RawSample;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &[RepresentationIdentifier::CDR_LE, RepresentationIdentifier::CDR_BE]
    }

    fn transform_decoded(decoded: RawSample) -> RawSample {
        decoded
    }
}

impl DefaultDecoder<RawSample> for Adapter {
    type Decoder = Decoder;
    const DECODER: Decoder = Decoder;
}

impl Decode<'_, RawSample> for Decoder {
    type Error = Infallible;

    fn decode_bytes(self, body: &[u8], encoding: RepresentationIdentifier) -> Result<RawSample, Infallible> {
        let representation = match encoding {
            RepresentationIdentifier::CDR_BE => Representation::CdrBe,
            _ => Representation::CdrLe,
        };
        let mut bytes = Vec::with_capacity(ENCAPSULATION + body.len());
        bytes.extend(representation.header());
        bytes.extend(body);
        Ok(RawSample { representation, bytes: bytes.into() })
    }
}

/// Gives bytes to RustDDS, which writes the encapsulation header itself, depending on the type of
/// the writer.
pub(super) struct Encoder<const LITTLE_ENDIAN: bool>;

impl<const LITTLE_ENDIAN: bool> SerializerAdapter<RawSample> for Encoder<LITTLE_ENDIAN> {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        match LITTLE_ENDIAN {
            true => RepresentationIdentifier::CDR_LE,
            false => RepresentationIdentifier::CDR_BE,
        }
    }

    fn to_bytes(sample: &RawSample) -> Result<Bytes, Infallible> {
        Ok(sample.bytes.slice(ENCAPSULATION..))
    }
}

#[cfg(test)]
#[path = "../../tests/unit/ros2/sample.rs"]
mod tests;
