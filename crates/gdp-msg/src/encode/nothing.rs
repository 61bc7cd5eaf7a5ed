//! The source of fields that only the receiving type has, and the sink of fields that only the
//! sending type has.

use super::{Block, Result, Sink, Source};
use crate::definition::{Count, Scalar};

/// The source of whole arrays. Longer arrays are read one number at a time.
static ZEROS: [u8; 1 << 16] = [0; 1 << 16];

/// A source of zeros, empty texts and empty sequences, the initial values of ROS 1 messages.
pub(crate) struct Zeros;

impl Source for Zeros {
    fn scalar(&mut self, _kind: Scalar) -> Result<u64> {
        Ok(0)
    }

    fn array(&mut self, kind: Scalar, count: Count, per: u32) -> Result<Option<Block<'_>>> {
        let scalars = if let Count::Fixed(length) = count { length as usize * per as usize } else { 0 };
        let bytes = scalars.checked_mul(kind.size()).and_then(|length| ZEROS.get(..length));
        Ok(bytes.map(|bytes| Block { bytes, big_endian: false }))
    }

    fn text(&mut self, _wide: bool) -> Result<&[u8]> {
        Ok(&[])
    }

    fn begin(&mut self, count: Count, _least: u64) -> Result<Option<u32>> {
        Ok(Some(if let Count::Fixed(length) = count { length } else { 0 }))
    }

    fn offset(&self) -> usize {
        0
    }

    fn finish(&mut self) -> Result<()> {
        Ok(())
    }
}

/// A sink that discards everything.
pub(crate) struct Nowhere;

impl Sink for Nowhere {
    const DISCARDS: bool = true;

    fn scalar(&mut self, _kind: Scalar, _bits: u64) -> Result<()> {
        Ok(())
    }

    fn array(&mut self, _kind: Scalar, _count: Count, _per: u32, _block: Block<'_>) -> Result<()> {
        Ok(())
    }

    fn text(&mut self, _wide: bool, _text: &[u8]) -> Result<()> {
        Ok(())
    }

    fn begin(&mut self, _count: Count, _known: Option<u32>) -> Result<usize> {
        Ok(0)
    }

    fn end(&mut self, _count: Count, _known: Option<u32>, _mark: usize, _elements: u32) -> Result<()> {
        Ok(())
    }
}
