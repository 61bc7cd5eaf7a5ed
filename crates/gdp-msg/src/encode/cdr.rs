//! Classic CDR (XCDR1) as the vendors of ROS 2 write it. Scalars are aligned to their size, counted
//! from the end of the encapsulation header. The length of a string includes its terminating zero.
//! A wide string has four bytes for each UTF-16 code unit and no terminator (Fast CDR and
//! `rmw_cyclonedds` agree). A message without fields is one byte.

use super::input::Input;
use super::output::Output;
use super::{Block, Fault, Result, Sink, Source};
use crate::definition::{Count, Scalar};

/// Size of the encapsulation header, in bytes: representation and options.
const ENCAPSULATION: usize = 4;
/// Maximum padding that a writer adds to a payload, to a multiple of four bytes. Payloads that are
/// serialized but not sent, as by `rclpy.serialization` for a bag, may have more. `rmw_fastrtps`
/// makes these as long as its size estimate. That counts the alignment of empty sequences, and
/// terminators of wide strings that are never written.
const MAX_PADDING: usize = 3;

pub(crate) struct CdrSource<'a> {
    input: Input<'a>,
    big_endian: bool,
    /// Buffer for the last wide string.
    text: String,
    /// Number of bytes that may follow the last field.
    padding: usize,
}

impl<'a> CdrSource<'a> {
    pub fn new(bytes: &'a [u8]) -> Result<Self> {
        let mut input = Input::new(bytes);
        let head = input.take(ENCAPSULATION)?;
        let big_endian = match u16::from_be_bytes([head[0], head[1]]) {
            0 => true,
            1 => false,
            other => return Err(Fault::Encapsulation(other)),
        };
        Ok(Self { input, big_endian, text: String::new(), padding: MAX_PADDING })
    }

    fn align(&mut self, size: usize) -> Result<()> {
        let padding = (ENCAPSULATION.wrapping_sub(self.input.offset())) & (size - 1);
        self.input.take(padding).map(|_| ())
    }

    fn word(&mut self) -> Result<u32> {
        self.scalar(Scalar::UInt32).map(|word| word as u32)
    }

    fn count(&mut self, count: Count) -> Result<u32> {
        match count {
            Count::One => Ok(1),
            Count::Fixed(length) => Ok(length),
            Count::Sequence(_) => self.word(),
        }
    }

    fn wide_text(&mut self) -> Result<&[u8]> {
        let units = self.word()?;
        self.padding += 4;
        let bytes = self.input.scalars(Scalar::UInt32, units.into())?;
        let unit = |word: &[u8; 4]| {
            let word = if self.big_endian { u32::from_be_bytes(*word) } else { u32::from_le_bytes(*word) };
            u16::try_from(word).map_err(|_| Fault::Unicode)
        };
        self.text.clear();
        let mut outside = Ok(());
        let units =
            bytes.as_chunks::<4>().0.iter().map_while(|word| unit(word).map_err(|fault| outside = Err(fault)).ok());
        for c in char::decode_utf16(units) {
            self.text.push(c.map_err(|_| Fault::Unicode)?);
        }
        outside.map(|()| self.text.as_bytes())
    }
}

impl Source for CdrSource<'_> {
    fn scalar(&mut self, kind: Scalar) -> Result<u64> {
        self.align(kind.size())?;
        self.input.scalar(kind, self.big_endian)
    }

    fn array(&mut self, kind: Scalar, count: Count, per: u32) -> Result<Option<Block<'_>>> {
        let scalars = u64::from(self.count(count)?) * u64::from(per);
        if scalars > 0 {
            self.align(kind.size())?;
        } else {
            self.padding += kind.size() - 1;
        }
        let bytes = self.input.scalars(kind, scalars)?;
        Ok(Some(Block { bytes, big_endian: self.big_endian }))
    }

    fn text(&mut self, wide: bool) -> Result<&[u8]> {
        if wide {
            return self.wide_text();
        }
        let length = self.word()?;
        if length == 0 {
            // The standard has no length of 0. Some writers send it for an empty string, and all
            // readers of ROS 2 accept it.
            return Ok(&[]);
        }
        match self.input.take(self.input.length(length.into(), 1)?)?.split_last() {
            Some((0, text)) => Ok(text),
            _ => Err(Fault::Unterminated),
        }
    }

    fn begin(&mut self, count: Count, least: u64) -> Result<Option<u32>> {
        let count = self.count(count)?;
        self.input.length(count.into(), least)?;
        Ok(Some(count))
    }

    fn empty(&mut self) -> Result<()> {
        self.input.take(1).map(|_| ())
    }

    fn offset(&self) -> usize {
        self.input.offset()
    }

    fn finish(&mut self) -> Result<()> {
        if self.input.left() <= self.padding { Ok(()) } else { Err(Fault::Trailing(self.input.left())) }
    }
}

pub(crate) struct CdrSink<'a> {
    output: Output<'a>,
    big_endian: bool,
}

impl<'a> CdrSink<'a> {
    pub fn new(mut output: Output<'a>, big_endian: bool) -> Result<Self> {
        output.put(&[0, u8::from(!big_endian), 0, 0])?;
        Ok(Self { output, big_endian })
    }

    fn align(&mut self, size: usize) -> Result<()> {
        let padding = (ENCAPSULATION.wrapping_sub(self.output.bytes.len())) & (size - 1);
        self.output.put(&[0; 8][..padding])
    }

    fn word(&mut self, word: u32) -> Result<()> {
        self.scalar(Scalar::UInt32, word.into())
    }
}

impl Sink for CdrSink<'_> {
    fn scalar(&mut self, kind: Scalar, bits: u64) -> Result<()> {
        self.align(kind.size())?;
        self.output.scalar(kind, bits, self.big_endian)
    }

    fn array(&mut self, kind: Scalar, count: Count, per: u32, block: Block<'_>) -> Result<()> {
        if let Count::Sequence(_) = count {
            self.word((block.bytes.len() / kind.size() / per as usize) as u32)?;
        }
        if !block.bytes.is_empty() {
            self.align(kind.size())?;
        }
        self.output.block(kind, block, self.big_endian)
    }

    fn text(&mut self, wide: bool, text: &[u8]) -> Result<()> {
        let too_long = |_| Fault::Output(u32::MAX as usize);
        if !wide {
            self.word(u32::try_from(text.len() + 1).map_err(too_long)?)?;
            self.output.put(text)?;
            return self.output.put(&[0]);
        }
        let text = str::from_utf8(text).map_err(|_| Fault::Unicode)?;
        self.word(u32::try_from(text.encode_utf16().count()).map_err(too_long)?)?;
        text.encode_utf16().try_for_each(|unit| self.word(unit.into()))
    }

    fn begin(&mut self, count: Count, known: Option<u32>) -> Result<usize> {
        if let Count::Sequence(_) = count {
            self.word(known.unwrap_or(0))?;
        }
        Ok(self.output.bytes.len())
    }

    fn end(&mut self, count: Count, known: Option<u32>, mark: usize, elements: u32) -> Result<()> {
        if let (Count::Sequence(_), None) = (count, known) {
            let word = if self.big_endian { elements.to_be_bytes() } else { elements.to_le_bytes() };
            self.output.bytes[mark - 4..mark].copy_from_slice(&word);
        }
        Ok(())
    }

    fn empty(&mut self) -> Result<()> {
        self.output.put(&[0])
    }
}
