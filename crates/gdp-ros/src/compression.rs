//! Compresses and decompresses message bodies. The encoding number says whether a body is
//! compressed. So every reader decompresses it, independent of its configuration. A reader that
//! does not know the number refuses the body.

use std::io;

use bytes::Bytes;
use gdp_e2e::seal::{Encoding, ReaderLimits};
use zstd::bulk::{Compressor, Decompressor};

/// Bit of the encoding number for a compressed body: one zstd frame that states its content length.
/// The other bits give the encoding of the content.
const ZSTD: u16 = 0x8000;

/// Compression level of zstd. Level 3 takes at least three times as long as level 1, and makes
/// camera images and point clouds only a few hundredths shorter.
const LEVEL: i32 = 1;

/// Minimum length of a body to compress, in bytes. The frame header would use up what compression
/// saves of a shorter body.
const WORTHWHILE: usize = 256;

/// The reason why a body cannot be compressed.
#[derive(Debug, thiserror::Error)]
#[error("cannot compress: {0}")]
pub struct PackError(#[from] io::Error);

/// The reason why a compressed body is refused.
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

/// Compresses the bodies of one topic.
pub struct Packer {
    compressor: Compressor<'static>,
    packed: Vec<u8>,
}

impl Packer {
    /// Creates a compressor.
    ///
    /// # Errors
    /// If no memory is available.
    pub fn new() -> Result<Self, PackError> {
        Ok(Self { compressor: Compressor::new(LEVEL)?, packed: Vec::new() })
    }

    /// Compresses `body` and returns the new encoding with the result. Returns both unchanged if
    /// compression would not make the body shorter.
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

/// Decompresses a received body and returns its encoding with it. Allocates at most the size of the
/// largest message.
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
