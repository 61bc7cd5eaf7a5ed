//! The encodings. Each reads and writes single values as a program of [`crate::mapping`] requests
//! them. No encoding knows types or builds values: each value goes directly from the source to the
//! sink.

pub(crate) mod cdr;
pub(crate) mod input;
pub(crate) mod json;
pub(crate) mod nothing;
pub(crate) mod output;
pub(crate) mod ros1;

use std::fmt;

use crate::definition::{Count, Scalar};

/// The encoding of a message.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Encoding {
    /// Classic CDR (XCDR1) after a four-byte encapsulation header, which ROS 2 sends over DDS.
    /// Readers accept both byte orders; the writer uses little-endian.
    Cdr,
    /// The same with a big-endian writer.
    CdrBigEndian,
    /// ROS 1 serialization, which ROS 1 sends over TCPROS, without the length prefix.
    Ros1,
    /// One JSON object in the form of rosbridge, but without loss: see [`crate`].
    Json,
}

impl fmt::Display for Encoding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Cdr => "CDR",
            Self::CdrBigEndian => "CDR (big endian)",
            Self::Ros1 => "ROS 1",
            Self::Json => "JSON",
        })
    }
}

/// The reason why a message is invalid.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
pub enum Fault {
    #[error("the message ends within it: it was cut off, or is of another type")]
    Truncated,
    #[error("{0} bytes follow the last field: the message is of another type, or of another version of it")]
    Trailing(usize),
    #[error("a length of {0} is more than the rest of the message can hold")]
    Length(u64),
    #[error("{0} elements, and the type allows {1}")]
    Count(u64, u64),
    #[error("a text of {0} units, and the type allows {1}")]
    Bound(usize, u32),
    #[error("a boolean of {0}: only 0 and 1 are")]
    Bool(u8),
    #[error("a text without its terminating zero byte")]
    Unterminated,
    #[error("text that is no Unicode, which JSON and wide strings cannot carry")]
    Unicode,
    #[error("{0} does not fit {1}, which is what the other side has in its place")]
    Range(i64, &'static str),
    #[error("the message would be larger than {0} bytes: raise the limit, if such messages are meant")]
    Output(usize),
    #[error("more than {0} steps over empty messages: nobody needs so many")]
    Nothing(u32),
    #[error("an encapsulation of {0:#06x}: only classic CDR (0x0000, 0x0001) is read, no XCDR2 and no parameter lists")]
    Encapsulation(u16),
    #[error("no JSON: {0}")]
    Syntax(&'static str),
    #[error("`{0}` is no value of {1}")]
    Value(String, &'static str),
    #[error("there is no field `{0}` in this type")]
    Unknown(String),
    #[error("the field `{0}` is missing: JSON messages give every field")]
    Absent(Box<str>),
    #[error("the field `{0}` is given twice")]
    Twice(Box<str>),
}

pub(crate) type Result<T, E = Fault> = std::result::Result<T, E>;

/// The names of an object's members, in the order of the definition.
pub(crate) type Members = [Box<str>];

/// Consecutive scalars in a binary encoding.
#[derive(Clone, Copy)]
pub(crate) struct Block<'a> {
    pub bytes: &'a [u8],
    pub big_endian: bool,
}

impl Block<'_> {
    /// Returns the bits of one scalar of the block.
    pub fn bits(&self, scalar: &[u8]) -> u64 {
        let append = |bits: u64, byte: &u8| bits << 8 | u64::from(*byte);
        if self.big_endian { scalar.iter().fold(0, append) } else { scalar.iter().rev().fold(0, append) }
    }
}

/// Reads messages. Scalars are their bits, zero-extended. The default methods do nothing, because
/// only JSON marks where objects and their members begin and end.
pub(crate) trait Source {
    fn scalar(&mut self, kind: Scalar) -> Result<u64>;
    /// Reads an array or a sequence with `per` scalars for each element as one block. Returns
    /// `None` and consumes nothing if the scalars must be read one by one.
    fn array(&mut self, kind: Scalar, count: Count, per: u32) -> Result<Option<Block<'_>>>;
    /// Reads a text. A `wide` text is returned as UTF-8; other text is unchecked bytes.
    fn text(&mut self, wide: bool) -> Result<&[u8]>;
    /// Begins an array or a sequence, and returns the number of elements if the encoding states it.
    /// `least` is the minimum size of an element in bytes.
    fn begin(&mut self, count: Count, least: u64) -> Result<Option<u32>>;
    /// Returns whether another element follows after `_done` elements, if the number is not stated.
    fn more(&mut self, _done: u32) -> Result<bool> {
        Ok(false)
    }
    fn open(&mut self, _members: &Members) -> Result<()> {
        Ok(())
    }
    /// Moves to the value of this member of the innermost open object.
    fn take(&mut self, _members: &Members, _member: usize) -> Result<()> {
        Ok(())
    }
    fn close(&mut self, _members: &Members) -> Result<()> {
        Ok(())
    }
    /// Reads a message without fields.
    fn empty(&mut self) -> Result<()> {
        Ok(())
    }
    /// Returns the position in the input, in bytes.
    fn offset(&self) -> usize;
    /// Checks that nothing but padding follows the last value.
    fn finish(&mut self) -> Result<()>;
}

/// Writes messages. The default methods do nothing, because only JSON needs them.
pub(crate) trait Sink {
    /// Whether the sink discards everything.
    const DISCARDS: bool = false;

    fn scalar(&mut self, kind: Scalar, bits: u64) -> Result<()>;
    /// Writes the block of [`Source::array`].
    fn array(&mut self, kind: Scalar, count: Count, per: u32, block: Block<'_>) -> Result<()>;
    fn text(&mut self, wide: bool, text: &[u8]) -> Result<()>;
    /// Begins an array or a sequence, with the number of elements if known. The return value goes
    /// to [`Sink::end`].
    fn begin(&mut self, count: Count, known: Option<u32>) -> Result<usize>;
    fn element(&mut self, _index: u32) -> Result<()> {
        Ok(())
    }
    fn end(&mut self, count: Count, known: Option<u32>, mark: usize, elements: u32) -> Result<()>;
    fn open(&mut self) -> Result<()> {
        Ok(())
    }
    fn put(&mut self, _members: &Members, _member: usize) -> Result<()> {
        Ok(())
    }
    fn close(&mut self) -> Result<()> {
        Ok(())
    }
    fn empty(&mut self) -> Result<()> {
        Ok(())
    }
}
