//! An output buffer of bytes with a size limit.

use super::{Block, Fault, Result};
use crate::definition::Scalar;

pub(crate) struct Output<'a> {
    pub bytes: &'a mut Vec<u8>,
    pub most: usize,
}

impl Output<'_> {
    /// Checks that `more` bytes fit into the size limit.
    pub fn room(&self, more: usize) -> Result<()> {
        if more <= self.most.saturating_sub(self.bytes.len()) { Ok(()) } else { Err(Fault::Output(self.most)) }
    }

    pub fn put(&mut self, bytes: &[u8]) -> Result<()> {
        self.room(bytes.len())?;
        self.bytes.extend_from_slice(bytes);
        Ok(())
    }

    pub fn scalar(&mut self, kind: Scalar, bits: u64, big_endian: bool) -> Result<()> {
        let size = kind.size();
        if big_endian { self.put(&bits.to_be_bytes()[8 - size..]) } else { self.put(&bits.to_le_bytes()[..size]) }
    }

    /// Writes consecutive scalars, and swaps the bytes of each if the byte orders differ.
    pub fn block(&mut self, kind: Scalar, block: Block<'_>, big_endian: bool) -> Result<()> {
        self.put(block.bytes)?;
        if block.big_endian == big_endian {
            return Ok(());
        }
        let start = self.bytes.len() - block.bytes.len();
        let added = &mut self.bytes[start..];
        match kind.size() {
            2 => added.as_chunks_mut::<2>().0.iter_mut().for_each(|scalar| scalar.reverse()),
            4 => added.as_chunks_mut::<4>().0.iter_mut().for_each(|scalar| scalar.reverse()),
            8 => added.as_chunks_mut::<8>().0.iter_mut().for_each(|scalar| scalar.reverse()),
            _ => {}
        }
        Ok(())
    }
}
