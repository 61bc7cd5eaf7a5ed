//! Compressed bodies. The number of the encoding says that a body is compressed. So every reader
//! decompresses it, whatever its configuration. A reader that does not know the number refuses the
//! body by it.

use std::io;

use bytes::Bytes;
use gdp_e2e::seal::{Encoding, ReaderLimits};
use zstd::bulk::{Compressor, Decompressor};

/// In the number of an encoding: the body is one zstd frame, which states its length, of a body in
/// the encoding of the other bits.
const ZSTD: u16 = 0x8000;

/// zstd's level. Of 1, 3 takes three times as long or more, for a few hundredths less of camera
/// images and point clouds.
const LEVEL: i32 = 1;

/// Shorter bodies go as they are: with the header of a frame and its tags they would hardly become
/// shorter.
const WORTHWHILE: usize = 256;

/// Why a body is not compressed.
#[derive(Debug, thiserror::Error)]
#[error("cannot compress: {0}")]
pub struct PackError(#[from] io::Error);

/// Why a compressed body is not taken.
#[derive(Debug, thiserror::Error)]
pub enum UnpackError {
    #[error("a compressed message that does not state its length: its writer is no proxy, or another version of one")]
    Unstated,
    #[error("a compressed message of {got} bytes, where at most {most} are taken")]
    TooLarge { got: u64, most: usize },
    #[error("a compressed message that is damaged: {0}")]
    Damaged(io::Error),
    #[error("a compressed message of {got} bytes that states a length of {stated}")]
    Misstated { got: usize, stated: u64 },
}

/// Compresses bodies of a topic.
pub struct Packer {
    compressor: Compressor<'static>,
    packed: Vec<u8>,
}

impl Packer {
    /// # Errors
    /// Without memory.
    pub fn new() -> Result<Self, PackError> {
        Ok(Self { compressor: Compressor::new(LEVEL)?, packed: Vec::new() })
    }

    /// The body as it is to travel, with what it is in then: as it was, where compressing does not
    /// make it shorter.
    pub fn pack<'a>(&'a mut self, encoding: Encoding, body: &'a [u8]) -> (Encoding, &'a [u8]) {
        if body.len() < WORTHWHILE || !is_packable(encoding) {
            return (encoding, body);
        }
        self.packed.clear();
        self.packed.reserve(zstd::compress_bound(body.len()));
        match self.compressor.compress_to_buffer(body, &mut self.packed) {
            Ok(length) if length < body.len() => (Encoding::from(u16::from(encoding) | ZSTD), &self.packed),
            _ => (encoding, body),
        }
    }
}

/// A body that came, and what it is in once it is not compressed any more. Takes no more memory
/// than the largest message.
pub fn unpacked(encoding: Encoding, body: Bytes) -> Result<(Encoding, Bytes), UnpackError> {
    let inner = Encoding::from(u16::from(encoding) & !ZSTD);
    if inner == encoding || !is_packable(inner) {
        return Ok((encoding, body));
    }
    let (stated, most) =
        (zstd::decompressed_size(&body).ok_or(UnpackError::Unstated)?, ReaderLimits::default().max_message);
    let length = usize::try_from(stated).ok().filter(|length| *length <= most);
    let mut output = Vec::with_capacity(length.ok_or(UnpackError::TooLarge { got: stated, most })?);
    let got = Decompressor::new().and_then(|mut zstd| zstd.decompress_to_buffer(&body, &mut output));
    match got.map_err(UnpackError::Damaged)? {
        got if got as u64 == stated => Ok((inner, output.into())),
        got => Err(UnpackError::Misstated { got, stated }),
    }
}

fn is_packable(encoding: Encoding) -> bool {
    matches!(encoding, Encoding::Json | Encoding::Cdr | Encoding::Ros1)
}

#[cfg(test)]
#[path = "../tests/unit/compression.rs"]
mod tests;
