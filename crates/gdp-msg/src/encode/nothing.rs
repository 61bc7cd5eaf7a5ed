//! The source of fields that only the target type has, and the sink of fields that only the source
//! type has.

use super::{Block, Result, Sink, Source};
use crate::definition::{Count, Scalar};

/// For arrays in one piece; longer ones are given number by number.
static ZEROS: [u8; 1 << 16] = [0; 1 << 16];

/// Gives zeros, empty texts and empty sequences: what a ROS 1 node begins a message with.
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

/// Takes everything, and keeps none of it.
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
