//! A cursor over bytes. It checks each read against the remaining bytes.

use super::{Fault, Result};
use crate::definition::Scalar;

pub(crate) struct Input<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Input<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    pub fn offset(&self) -> usize {
        self.at
    }

    pub fn left(&self) -> usize {
        self.bytes.len() - self.at
    }

    pub fn take(&mut self, length: usize) -> Result<&'a [u8]> {
        let taken = self.bytes[self.at..].get(..length).ok_or(Fault::Truncated)?;
        self.at += length;
        Ok(taken)
    }

    /// Reads the bits of a scalar in this byte order. A boolean must be 0 or 1.
    pub fn scalar(&mut self, kind: Scalar, big_endian: bool) -> Result<u64> {
        let taken = self.take(kind.size())?;
        let mut bits = [0; 8];
        if big_endian {
            bits[8 - taken.len()..].copy_from_slice(taken);
            return booleans(kind, taken).map(|()| u64::from_be_bytes(bits));
        }
        bits[..taken.len()].copy_from_slice(taken);
        booleans(kind, taken).map(|()| u64::from_le_bytes(bits))
    }

    /// Reads `count` consecutive scalars.
    pub fn scalars(&mut self, kind: Scalar, count: u64) -> Result<&'a [u8]> {
        let taken = self.take(self.length(count, kind.size() as u64)?)?;
        booleans(kind, taken)?;
        Ok(taken)
    }

    /// Returns the size of `count` elements of `least` bytes each, which must fit into the
    /// remaining bytes.
    pub fn length(&self, count: u64, least: u64) -> Result<usize> {
        let length = count.checked_mul(least).and_then(|length| usize::try_from(length).ok());
        length.filter(|length| *length <= self.left()).ok_or(Fault::Length(count))
    }
}

fn booleans(kind: Scalar, bytes: &[u8]) -> Result<()> {
    match bytes.iter().find(|byte| kind == Scalar::Bool && **byte > 1) {
        Some(byte) => Err(Fault::Bool(*byte)),
        None => Ok(()),
    }
}
