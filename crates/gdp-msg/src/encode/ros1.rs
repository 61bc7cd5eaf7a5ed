//! ROS 1 serialization: little-endian and unaligned. Strings and sequences follow a 32-bit length.

use super::input::Input;
use super::output::Output;
use super::{Block, Fault, Result, Sink, Source};
use crate::definition::{Count, Scalar};

pub(crate) struct Ros1Source<'a>(Input<'a>);

impl<'a> Ros1Source<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Self(Input::new(bytes))
    }

    fn count(&mut self, count: Count) -> Result<u32> {
        match count {
            Count::One => Ok(1),
            Count::Fixed(length) => Ok(length),
            Count::Sequence(_) => Ok(self.0.scalar(Scalar::UInt32, false)? as u32),
        }
    }
}

impl Source for Ros1Source<'_> {
    fn scalar(&mut self, kind: Scalar) -> Result<u64> {
        self.0.scalar(kind, false)
    }

    fn array(&mut self, kind: Scalar, count: Count, per: u32) -> Result<Option<Block<'_>>> {
        let count = self.count(count)?;
        let bytes = self.0.scalars(kind, u64::from(count) * u64::from(per))?;
        Ok(Some(Block { bytes, big_endian: false }))
    }

    fn text(&mut self, _wide: bool) -> Result<&[u8]> {
        let length = self.0.scalar(Scalar::UInt32, false)?;
        self.0.take(self.0.length(length, 1)?)
    }

    fn begin(&mut self, count: Count, least: u64) -> Result<Option<u32>> {
        let count = self.count(count)?;
        self.0.length(count.into(), least)?;
        Ok(Some(count))
    }

    fn offset(&self) -> usize {
        self.0.offset()
    }

    fn finish(&mut self) -> Result<()> {
        if self.0.left() == 0 { Ok(()) } else { Err(Fault::Trailing(self.0.left())) }
    }
}

pub(crate) struct Ros1Sink<'a>(pub Output<'a>);

impl Sink for Ros1Sink<'_> {
    fn scalar(&mut self, kind: Scalar, bits: u64) -> Result<()> {
        self.0.scalar(kind, bits, false)
    }

    fn array(&mut self, kind: Scalar, count: Count, per: u32, block: Block<'_>) -> Result<()> {
        if let Count::Sequence(_) = count {
            let elements = block.bytes.len() / kind.size() / per as usize;
            self.scalar(Scalar::UInt32, elements as u64)?;
        }
        self.0.block(kind, block, false)
    }

    fn text(&mut self, _wide: bool, text: &[u8]) -> Result<()> {
        let length = u32::try_from(text.len()).map_err(|_| Fault::Output(u32::MAX as usize))?;
        self.scalar(Scalar::UInt32, length.into())?;
        self.0.put(text)
    }

    fn begin(&mut self, count: Count, known: Option<u32>) -> Result<usize> {
        if let Count::Sequence(_) = count {
            self.scalar(Scalar::UInt32, known.unwrap_or(0).into())?;
        }
        Ok(self.0.bytes.len())
    }

    fn end(&mut self, count: Count, known: Option<u32>, mark: usize, elements: u32) -> Result<()> {
        if let (Count::Sequence(_), None) = (count, known) {
            self.0.bytes[mark - 4..mark].copy_from_slice(&elements.to_le_bytes());
        }
        Ok(())
    }
}
