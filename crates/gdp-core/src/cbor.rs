//! Deterministic CBOR (RFC 8949 §4.2.1) of serde types. Byte arrays become byte strings, or hex
//! text in human-readable formats. Certificates and control messages use it. Nothing here depends
//! on what it encodes.

pub use ciborium::Value;
use serde::{Serialize, de::DeserializeOwned};

/// Maximum nesting depth, far above that of any valid value of this project.
const MAX_DEPTH: usize = 16;

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CborError {
    #[error("{got} bytes of CBOR where at most {max} are allowed")]
    TooLong { got: usize, max: usize },
    #[error("not valid CBOR of the expected shape: {0}")]
    Malformed(String),
    #[error("not deterministic CBOR (RFC 8949 §4.2.1): one value must have one encoding")]
    NotDeterministic,
    #[error("this value cannot be encoded as CBOR: {0}")]
    Unencodable(String),
}

/// Encodes `value` with map keys in bytewise order of their encodings, shortest integers and
/// definite lengths.
pub fn encode<T: Serialize + ?Sized>(value: &T) -> Result<Vec<u8>, CborError> {
    let mut value = Value::serialized(value).map_err(|e| CborError::Unencodable(e.to_string()))?;
    sort_maps(&mut value)?;
    to_bytes(&value)
}

/// Decodes `bytes` as exactly one `T`. Refuses more than `max` bytes.
///
/// Also refuses any encoding that [`encode`] would not produce, and thereby trailing bytes,
/// duplicate keys and fields unknown to `T`.
pub fn decode<T: DeserializeOwned + Serialize>(bytes: &[u8], max: usize) -> Result<T, CborError> {
    let value: T = read(bytes, max)?;
    if encode(&value)? != bytes {
        return Err(CborError::NotDeterministic);
    }
    Ok(value)
}

/// Decodes a map as [`decode`] does, except that it may have fields unknown to `T`. Returns these
/// beside the value. `T` must ignore them.
pub fn decode_open<T: DeserializeOwned + Serialize>(
    bytes: &[u8],
    max: usize,
) -> Result<(T, Vec<(Value, Value)>), CborError> {
    let value: T = read(bytes, max)?;
    let known = encode(&value)?;
    if known == bytes {
        return Ok((value, Vec::new()));
    }
    let (Value::Map(all), Value::Map(fields)) = (decode(bytes, max)?, decode(&known, known.len())?) else {
        return Err(CborError::NotDeterministic);
    };
    let is_known = |(key, _): &(Value, Value)| fields.iter().any(|(field, _)| field == key);
    let (own, others): (Vec<_>, Vec<_>) = all.into_iter().partition(is_known);
    if encode(&Value::Map(own))? != known {
        return Err(CborError::NotDeterministic);
    }
    Ok((value, others))
}

fn read<T: DeserializeOwned>(bytes: &[u8], max: usize) -> Result<T, CborError> {
    if bytes.len() > max {
        return Err(CborError::TooLong { got: bytes.len(), max });
    }
    ciborium::de::from_reader_with_recursion_limit(bytes, MAX_DEPTH).map_err(|e| CborError::Malformed(explain(&e)))
}

/// Returns what is wrong with undecodable bytes, in words. The decoder's own text is that of its
/// data structures.
pub fn explain<E>(error: &ciborium::de::Error<E>) -> String {
    match error {
        ciborium::de::Error::Io(_) => "it ends too early".into(),
        ciborium::de::Error::Syntax(at) => format!("byte {at} begins no value"),
        ciborium::de::Error::Semantic(_, reason) => reason.clone(),
        ciborium::de::Error::RecursionLimitExceeded => "its values are nested too deeply".into(),
    }
}

fn sort_maps(value: &mut Value) -> Result<(), CborError> {
    match value {
        Value::Array(items) => items.iter_mut().try_for_each(sort_maps),
        Value::Tag(_, inner) => sort_maps(inner),
        Value::Map(entries) => {
            let mut keyed = Vec::with_capacity(entries.len());
            for (mut key, mut value) in std::mem::take(entries) {
                sort_maps(&mut key)?;
                sort_maps(&mut value)?;
                keyed.push((to_bytes(&key)?, key, value));
            }
            keyed.sort_by(|a, b| a.0.cmp(&b.0));
            if keyed.windows(2).any(|pair| pair[0].0 == pair[1].0) {
                return Err(CborError::Unencodable("a map key occurs twice".into()));
            }
            entries.extend(keyed.into_iter().map(|(_, key, value)| (key, value)));
            Ok(())
        }
        _ => Ok(()),
    }
}

fn to_bytes(value: &Value) -> Result<Vec<u8>, CborError> {
    let mut out = Vec::new();
    ciborium::into_writer(value, &mut out).map_err(|e| CborError::Unencodable(e.to_string()))?;
    Ok(out)
}

/// `#[serde(with = "gdp::cbor::array")]` for `[u8; N]`: a byte string in CBOR, lower-case hex text
/// in JSON and YAML.
pub mod array {
    use serde::{Deserializer, Serializer, de::Error};

    pub fn serialize<S: Serializer, const N: usize>(bytes: &[u8; N], serializer: S) -> Result<S::Ok, S::Error> {
        super::bytes::serialize(bytes.as_slice(), serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>, const N: usize>(deserializer: D) -> Result<[u8; N], D::Error> {
        let bytes = super::bytes::deserialize(deserializer)?;
        let got = bytes.len();
        bytes.try_into().map_err(|_| D::Error::custom(format_args!("{got} bytes where {N} are expected")))
    }
}

/// `#[serde(with = "gdp::cbor::bytes")]` for `Vec<u8>`: a byte string in CBOR, lower-case hex text
/// in JSON and YAML.
pub mod bytes {
    use serde::de::{Deserializer, Error, Visitor};
    use serde::ser::Serializer;
    use std::fmt;

    pub fn serialize<S: Serializer>(bytes: &[u8], serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            serializer.serialize_str(&hex::encode(bytes))
        } else {
            serializer.serialize_bytes(bytes)
        }
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<u8>, D::Error> {
        if deserializer.is_human_readable() {
            deserializer.deserialize_str(BytesVisitor)
        } else {
            deserializer.deserialize_byte_buf(BytesVisitor)
        }
    }

    struct BytesVisitor;

    impl Visitor<'_> for BytesVisitor {
        type Value = Vec<u8>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("a byte string, or hex digits")
        }

        fn visit_str<E: Error>(self, text: &str) -> Result<Vec<u8>, E> {
            hex::decode(text).map_err(E::custom)
        }

        fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<Vec<u8>, E> {
            Ok(bytes.to_vec())
        }

        fn visit_byte_buf<E: Error>(self, bytes: Vec<u8>) -> Result<Vec<u8>, E> {
            Ok(bytes)
        }
    }
}

#[cfg(test)]
#[path = "../tests/unit/cbor.rs"]
mod tests;
