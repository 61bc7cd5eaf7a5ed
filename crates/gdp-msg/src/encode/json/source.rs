//! Reads JSON. It reads fields directly if they have the order of the definition, which is usual.
//! For other objects a first pass finds the position of each field's value.

use base64ct::{Base64, Encoding as _};

use super::scan::Scan;
use super::{is_octet, scan};
use crate::definition::{Count, Scalar};
use crate::encode::{Block, Fault, Members, Result, Source};
use crate::name::excerpt;

pub(crate) struct JsonSource<'a> {
    scan: Scan<'a>,
    /// The open objects, innermost last.
    objects: Vec<Object>,
    text: String,
    octets: Vec<u8>,
}

struct Object {
    /// The position after the opening brace.
    start: usize,
    /// Number of members that were read in order.
    taken: usize,
    /// The position of each member's value if they have another order, and the end of the object.
    found: Option<(Vec<usize>, usize)>,
}

impl<'a> JsonSource<'a> {
    pub fn new(bytes: &'a [u8]) -> Result<Self> {
        let text = str::from_utf8(bytes).map_err(|_| Fault::Unicode)?;
        Ok(Self { scan: Scan::new(text), objects: Vec::new(), text: String::new(), octets: Vec::new() })
    }

    /// Reads a string.
    fn string(&mut self) -> Result<&str> {
        let quoted = self.scan.quoted("a string is expected")?;
        self.unescaped(quoted)
    }

    fn unescaped<'s>(&'s mut self, quoted: scan::Quoted<'s>) -> Result<&'s str> {
        if !quoted.escaped {
            return Ok(quoted.raw);
        }
        self.text.clear();
        quoted.unescape(&mut self.text)?;
        Ok(&self.text)
    }

    /// Reads the name of a member and the colon.
    fn key(&mut self) -> Result<scan::Quoted<'a>> {
        let key = self.scan.quoted("the name of a field is expected")?;
        self.scan.expect(b':', "a colon is expected")?;
        Ok(key)
    }

    /// Scans the object that begins at `start`, and returns the position of each member's value and
    /// of its end.
    fn find(&mut self, members: &Members, start: usize) -> Result<(Vec<usize>, usize)> {
        let mut found = vec![None; members.len()];
        self.scan.at = start;
        let mut first = true;
        while !self.scan.accept(b'}') {
            if !first {
                self.scan.expect(b',', "a comma or the end of an object is expected")?;
            }
            first = false;
            let key = self.key()?;
            let key = self.unescaped(key)?;
            let Some(index) = members.iter().position(|member| **member == *key) else {
                return Err(Fault::Unknown(excerpt(key)));
            };
            let at = self.scan.at;
            if found[index].replace(at).is_some() {
                return Err(Fault::Twice(members[index].clone()));
            }
            self.scan.skip()?;
        }
        let given = found.iter().zip(members).map(|(at, member)| at.ok_or_else(|| Fault::Absent(member.clone())));
        Ok((given.collect::<Result<_>>()?, self.scan.at))
    }
}

impl Source for JsonSource<'_> {
    fn scalar(&mut self, kind: Scalar) -> Result<u64> {
        let quoted = self.scan.peek() == Some(b'"');
        if quoted {
            let text = self.string()?;
            return quoted_number(kind, text).ok_or_else(|| Fault::Value(excerpt(text), kind.name()));
        }
        let text = self.scan.bare()?;
        number(kind, text).ok_or_else(|| Fault::Value(excerpt(text), kind.name()))
    }

    fn array(&mut self, kind: Scalar, _count: Count, _per: u32) -> Result<Option<Block<'_>>> {
        if !is_octet(kind) || self.scan.peek() != Some(b'"') {
            return Ok(None);
        }
        let mut octets = std::mem::take(&mut self.octets);
        let base64 = self.string()?;
        octets.resize(base64.len() / 4 * 3, 0);
        let length =
            Base64::decode(base64, &mut octets).map_err(|_| Fault::Syntax("a string that is no base64"))?.len();
        self.octets = octets;
        Ok(Some(Block { bytes: &self.octets[..length], big_endian: false }))
    }

    fn text(&mut self, _wide: bool) -> Result<&[u8]> {
        self.string().map(str::as_bytes)
    }

    fn begin(&mut self, _count: Count, _least: u64) -> Result<Option<u32>> {
        self.scan.expect(b'[', "an array is expected")?;
        Ok(None)
    }

    fn more(&mut self, done: u32) -> Result<bool> {
        if self.scan.accept(b']') {
            return Ok(false);
        }
        if done > 0 {
            self.scan.expect(b',', "a comma or the end of an array is expected")?;
        }
        Ok(true)
    }

    fn open(&mut self, _members: &Members) -> Result<()> {
        self.scan.expect(b'{', "an object is expected")?;
        self.objects.push(Object { start: self.scan.at, taken: 0, found: None });
        Ok(())
    }

    fn take(&mut self, members: &Members, member: usize) -> Result<()> {
        let Some(object) = self.objects.last_mut() else { return Ok(()) };
        if object.found.is_none() {
            let (start, taken) = (object.start, object.taken);
            object.taken += 1;
            let comma = taken == 0 || self.scan.accept(b',');
            if comma && self.scan.peek() == Some(b'"') {
                let key = self.key()?;
                if self.unescaped(key)? == &*members[member] {
                    return Ok(());
                }
            }
            let found = self.find(members, start)?;
            self.objects.last_mut().expect("it is open").found = Some(found);
        }
        let Some(Object { found: Some((values, _)), .. }) = self.objects.last() else { return Ok(()) };
        self.scan.at = values[member];
        Ok(())
    }

    fn close(&mut self, members: &Members) -> Result<()> {
        match self.objects.pop() {
            Some(Object { found: Some((_, end)), .. }) => self.scan.at = end,
            Some(object) if !self.scan.accept(b'}') => {
                // The scan returns an error that names the surplus member.
                self.find(members, object.start)?;
                return Err(Fault::Syntax("the end of an object is expected"));
            }
            _ => {}
        }
        Ok(())
    }

    fn offset(&self) -> usize {
        self.scan.at
    }

    fn finish(&mut self) -> Result<()> {
        if self.scan.peek().is_none() { Ok(()) } else { Err(Fault::Syntax("something follows the message")) }
    }
}

/// Returns the bits of an unquoted value.
fn number(kind: Scalar, text: &str) -> Option<u64> {
    if kind == Scalar::Bool {
        return ["false", "true"].iter().position(|word| *word == text).map(|bit| bit as u64);
    }
    if !is_number(text) {
        return None;
    }
    match kind {
        Scalar::Int8 => text.parse::<i8>().ok().map(|value| u64::from(value as u8)),
        Scalar::Int16 => text.parse::<i16>().ok().map(|value| u64::from(value as u16)),
        Scalar::Int32 => text.parse::<i32>().ok().map(|value| u64::from(value as u32)),
        Scalar::Int64 => text.parse::<i64>().ok().map(|value| value as u64),
        Scalar::UInt16 => text.parse::<u16>().ok().map(Into::into),
        Scalar::UInt32 => text.parse::<u32>().ok().map(Into::into),
        Scalar::UInt64 => text.parse::<u64>().ok(),
        Scalar::Float32 => {
            text.parse().ok().filter(|value: &f32| value.is_finite()).map(|value| value.to_bits().into())
        }
        Scalar::Float64 => text.parse().ok().filter(|value: &f64| value.is_finite()).map(f64::to_bits),
        Scalar::Bool => None,
        Scalar::UInt8 | Scalar::Byte | Scalar::Char => text.parse::<u8>().ok().map(Into::into),
    }
}

/// Returns the bits of a quoted value: a 64-bit integer or a special floating-point value.
fn quoted_number(kind: Scalar, text: &str) -> Option<u64> {
    let special = match text {
        "NaN" => f64::NAN,
        "Infinity" => f64::INFINITY,
        "-Infinity" => f64::NEG_INFINITY,
        _ if matches!(kind, Scalar::Int64 | Scalar::UInt64) => return number(kind, text),
        _ => return None,
    };
    match kind {
        Scalar::Float32 => Some((special as f32).to_bits().into()),
        Scalar::Float64 => Some(special.to_bits()),
        _ => None,
    }
}

/// Returns whether the text is a JSON number.
fn is_number(text: &str) -> bool {
    let digits = |text: &str| text.bytes().take_while(u8::is_ascii_digit).count();
    let rest = text.strip_prefix('-').unwrap_or(text);
    let whole = digits(rest);
    if whole == 0 || (whole > 1 && rest.starts_with('0')) {
        return false;
    }
    let mut rest = &rest[whole..];
    if let Some(fraction) = rest.strip_prefix('.') {
        let length = digits(fraction);
        if length == 0 {
            return false;
        }
        rest = &fraction[length..];
    }
    if let Some(exponent) = rest.strip_prefix(['e', 'E']) {
        let exponent = exponent.strip_prefix(['+', '-']).unwrap_or(exponent);
        return !exponent.is_empty() && digits(exponent) == exponent.len();
    }
    rest.is_empty()
}
