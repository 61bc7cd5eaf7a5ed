//! Writes compact JSON.

use std::io::Write;

use base64ct::{Base64, Encoding as _};

use super::{EXACT, is_octet};
use crate::definition::{Count, Scalar};
use crate::encode::output::Output;
use crate::encode::{Block, Fault, Members, Result, Sink};

pub(crate) struct JsonSink<'a>(pub Output<'a>);

/// Maximum length of a scalar as text with its quotes, in bytes.
const MAX_SCALAR: usize = 40;

impl JsonSink<'_> {
    fn quoted(&mut self, text: &str) -> Result<()> {
        self.0.put(b"\"")?;
        let mut rest = text.as_bytes();
        while let Some(plain) = rest.iter().position(|byte| matches!(byte, b'"' | b'\\' | 0..0x20)) {
            self.0.put(&rest[..plain])?;
            match rest[plain] {
                b'"' => self.0.put(b"\\\"")?,
                b'\\' => self.0.put(b"\\\\")?,
                b'\n' => self.0.put(b"\\n")?,
                b'\r' => self.0.put(b"\\r")?,
                b'\t' => self.0.put(b"\\t")?,
                control => self.0.put(format!("\\u{control:04x}").as_bytes())?,
            }
            rest = &rest[plain + 1..];
        }
        self.0.put(rest)?;
        self.0.put(b"\"")
    }

    fn base64(&mut self, octets: &[u8]) -> Result<()> {
        // The length is checked before any allocation, because the input may have any size.
        let length = octets.len().div_ceil(3).saturating_mul(4);
        self.0.room(length.saturating_add(2))?;
        self.0.put(b"\"")?;
        let start = self.0.bytes.len();
        self.0.bytes.resize(start + length, 0);
        let written = Base64::encode(octets, &mut self.0.bytes[start..]).map(str::len);
        assert_eq!(written, Ok(length), "the length of base64");
        self.0.put(b"\"")
    }

    fn integer(&mut self, value: impl std::fmt::Display, exact: bool) {
        // Writing to a vector cannot fail.
        let _ = if exact { write!(self.0.bytes, "{value}") } else { write!(self.0.bytes, "\"{value}\"") };
    }

    fn float(&mut self, finite: Option<&str>, value: f64) {
        let text = match finite {
            Some(text) => text,
            None if value.is_nan() => "\"NaN\"",
            None if value > 0.0 => "\"Infinity\"",
            None => "\"-Infinity\"",
        };
        self.0.bytes.extend_from_slice(text.as_bytes());
    }
}

impl Sink for JsonSink<'_> {
    fn scalar(&mut self, kind: Scalar, bits: u64) -> Result<()> {
        self.0.room(MAX_SCALAR)?;
        match kind {
            Scalar::Bool => self.0.bytes.extend_from_slice(if bits == 0 { b"false" } else { b"true" }),
            Scalar::Int8 => self.integer(bits as u8 as i8, true),
            Scalar::Int16 => self.integer(bits as u16 as i16, true),
            Scalar::Int32 => self.integer(bits as u32 as i32, true),
            Scalar::Int64 => self.integer(bits as i64, (bits as i64).unsigned_abs() <= EXACT),
            Scalar::Byte | Scalar::Char | Scalar::UInt8 | Scalar::UInt16 | Scalar::UInt32 => self.integer(bits, true),
            Scalar::UInt64 => self.integer(bits, bits <= EXACT),
            Scalar::Float32 => {
                let value = f32::from_bits(bits as u32);
                let mut buffer = zmij::Buffer::new();
                self.float(value.is_finite().then(|| buffer.format_finite(value)), value.into());
            }
            Scalar::Float64 => {
                let value = f64::from_bits(bits);
                let mut buffer = zmij::Buffer::new();
                self.float(value.is_finite().then(|| buffer.format_finite(value)), value);
            }
        }
        Ok(())
    }

    fn array(&mut self, kind: Scalar, count: Count, _per: u32, block: Block<'_>) -> Result<()> {
        if is_octet(kind) {
            return self.base64(block.bytes);
        }
        let mark = self.begin(count, None)?;
        let mut elements = 0;
        for scalar in block.bytes.chunks_exact(kind.size()) {
            self.element(elements)?;
            self.scalar(kind, block.bits(scalar))?;
            elements += 1;
        }
        self.end(count, None, mark, elements)
    }

    fn text(&mut self, _wide: bool, text: &[u8]) -> Result<()> {
        self.quoted(str::from_utf8(text).map_err(|_| Fault::Unicode)?)
    }

    fn begin(&mut self, _count: Count, _known: Option<u32>) -> Result<usize> {
        self.0.put(b"[")?;
        Ok(0)
    }

    fn element(&mut self, index: u32) -> Result<()> {
        if index > 0 { self.0.put(b",") } else { Ok(()) }
    }

    fn end(&mut self, _count: Count, _known: Option<u32>, _mark: usize, _elements: u32) -> Result<()> {
        self.0.put(b"]")
    }

    fn open(&mut self) -> Result<()> {
        self.0.put(b"{")
    }

    fn put(&mut self, members: &Members, member: usize) -> Result<()> {
        if member > 0 {
            self.0.put(b",")?;
        }
        self.quoted(&members[member])?;
        self.0.put(b":")
    }

    fn close(&mut self) -> Result<()> {
        self.0.put(b"}")
    }
}
