//! The 256-bit name of a topic, service, action, log or entity. `gdp::name` derives names; a data
//! plane only compares them.

use core::fmt;
use core::str::FromStr;

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// A 256-bit name. Displayed in full as 64 lower-case hex digits; `{:#}` is the short form for
/// human readers (`75e…0fc`).
#[derive(Clone, Copy, PartialEq, Eq, Hash, Default, FromBytes, IntoBytes, KnownLayout, Immutable)]
#[repr(C)]
pub struct Name([u64; 4]);

impl Name {
    /// Returns the name with these 32 bytes, in wire order.
    #[inline(always)]
    pub const fn from_bytes(bytes: [u8; 32]) -> Self {
        // SAFETY: both types are 32 bytes of plain data without invalid values.
        Self(unsafe { core::mem::transmute::<[u8; 32], [u64; 4]>(bytes) })
    }

    /// Returns the 32 bytes of the name, in wire order.
    #[inline(always)]
    pub const fn to_bytes(self) -> [u8; 32] {
        // SAFETY: both types are 32 bytes of plain data without invalid values.
        unsafe { core::mem::transmute::<[u64; 4], [u8; 32]>(self.0) }
    }

    /// Returns the 32 bytes of the name, in wire order.
    #[inline(always)]
    pub fn as_bytes(&self) -> &[u8; 32] {
        // SAFETY: the array covers exactly this value, and a byte needs no alignment.
        unsafe { &*(&raw const self.0).cast::<[u8; 32]>() }
    }

    /// Returns the name with these [`Self::words`].
    #[cfg(target_has_atomic = "64")]
    pub(crate) const fn from_words(words: [u64; 4]) -> Self {
        Self(words)
    }

    /// Returns whether both names are the same. Unlike `==`, the BPF compiler does not turn this
    /// into a function call.
    #[inline(always)]
    pub const fn is(&self, other: &Self) -> bool {
        let ([a, b, c, d], [e, f, g, h]) = (self.0, other.0);
        (a ^ e) | (b ^ f) | (c ^ g) | (d ^ h) == 0
    }

    /// Returns the four machine words of the name as in memory: for hashing and comparing, never
    /// for arithmetic.
    #[inline(always)]
    pub const fn words(&self) -> &[u64; 4] {
        &self.0
    }
}

/// Orders names by their bytes in wire order, so that the order is the same on all machines.
impl Ord for Name {
    fn cmp(&self, other: &Self) -> core::cmp::Ordering {
        self.as_bytes().cmp(other.as_bytes())
    }
}

impl PartialOrd for Name {
    fn partial_cmp(&self, other: &Self) -> Option<core::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let bytes = self.as_bytes();
        if f.alternate() {
            let (head, tail) = (u16::from_be_bytes([bytes[0], bytes[1]]), u16::from_be_bytes([bytes[30], bytes[31]]));
            return write!(f, "{:03x}…{:03x}", head >> 4, tail & 0xfff);
        }
        bytes.iter().try_for_each(|b| write!(f, "{b:02x}"))
    }
}

impl fmt::Debug for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Name({self:#})")
    }
}

/// The text is not a name: a name is exactly 64 hex digits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ParseNameError;

impl fmt::Display for ParseNameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a name is 64 hex digits")
    }
}

impl core::error::Error for ParseNameError {}

impl FromStr for Name {
    type Err = ParseNameError;

    fn from_str(text: &str) -> Result<Self, ParseNameError> {
        let digits = text.as_bytes();
        if digits.len() != 64 {
            return Err(ParseNameError);
        }
        let digit = |c: u8| (c as char).to_digit(16).map(|d| d as u8).ok_or(ParseNameError);
        let mut bytes = [0u8; 32];
        for (byte, pair) in bytes.iter_mut().zip(digits.chunks_exact(2)) {
            *byte = digit(pair[0])? << 4 | digit(pair[1])?;
        }
        Ok(Self::from_bytes(bytes))
    }
}

#[cfg(feature = "serde")]
mod serde_impls {
    use super::Name;
    use core::fmt;
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

    /// Serializes as hex text in human-readable formats and as 32 bytes in binary formats.
    impl Serialize for Name {
        fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
            if serializer.is_human_readable() {
                serializer.collect_str(self)
            } else {
                serializer.serialize_bytes(self.as_bytes())
            }
        }
    }

    struct Visitor;

    impl<'de> de::Visitor<'de> for Visitor {
        type Value = Name;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("a 256-bit name")
        }

        fn visit_str<E: de::Error>(self, text: &str) -> Result<Name, E> {
            text.parse().map_err(E::custom)
        }

        fn visit_bytes<E: de::Error>(self, bytes: &[u8]) -> Result<Name, E> {
            bytes.try_into().map(Name::from_bytes).map_err(|_| E::invalid_length(bytes.len(), &self))
        }
    }

    impl<'de> Deserialize<'de> for Name {
        fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
            if deserializer.is_human_readable() {
                deserializer.deserialize_str(Visitor)
            } else {
                deserializer.deserialize_bytes(Visitor)
            }
        }
    }
}

#[cfg(feature = "schemars")]
impl schemars::JsonSchema for Name {
    fn schema_name() -> alloc::borrow::Cow<'static, str> {
        "Name".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({"type": "string", "pattern": "^[0-9a-f]{64}$"})
    }
}

#[cfg(test)]
#[path = "../tests/unit/name.rs"]
mod tests;
