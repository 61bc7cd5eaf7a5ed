//! Derivation of names from owner key and metadata, and the prefixes that commands accept.
//! `docs/wire-format.md`, "Names", specifies the bytes: `name = SHA-256("gdp/name/1" ‖ owner key ‖
//! SHA-256(JCS(metadata)))`.

use crate::crypto::{self, CryptoError, PUBLIC_KEY_LEN};
use crate::verify_key::VerifyKey;
pub use gdp_wire::Name;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

/// String map from which a name is derived. Its order in memory is not the order of its canonical
/// form.
pub type Metadata = BTreeMap<String, String>;

/// Returns the SHA-256 hash of the canonical JSON (RFC 8785) of `metadata`.
pub fn inner_digest(metadata: &Metadata) -> [u8; 32] {
    crypto::sha256(&[canonical_json(metadata).as_bytes()])
}

/// Derives the name from `owner_key` (SEC1 compressed) and the inner digest of its metadata.
pub fn derive(owner_key: &[u8; PUBLIC_KEY_LEN], digest: &[u8; 32]) -> Name {
    Name::from_bytes(crypto::sha256(&[b"gdp/name/1", owner_key, digest]))
}

/// Returns the canonical JSON (RFC 8785) of a map of strings. Keys are ordered by their UTF-16 code
/// units, with no white space and the fewest escapes.
pub fn canonical_json(metadata: &Metadata) -> String {
    let mut entries: Vec<(&String, &String)> = metadata.iter().collect();
    entries.sort_by(|a, b| a.0.encode_utf16().cmp(b.0.encode_utf16()));
    let mut json = String::from("{");
    for (i, (key, value)) in entries.into_iter().enumerate() {
        if i > 0 {
            json.push(',');
        }
        push_string(&mut json, key);
        json.push(':');
        push_string(&mut json, value);
    }
    json.push('}');
    json
}

/// Appends a string literal (RFC 8785 §3.2.2.2).
fn push_string(json: &mut String, text: &str) {
    json.push('"');
    for c in text.chars() {
        match c {
            '"' => json.push_str("\\\""),
            '\\' => json.push_str("\\\\"),
            '\u{8}' => json.push_str("\\b"),
            '\t' => json.push_str("\\t"),
            '\n' => json.push_str("\\n"),
            '\u{c}' => json.push_str("\\f"),
            '\r' => json.push_str("\\r"),
            c if c < ' ' => json.push_str(&format!("\\u{:04x}", c as u32)),
            c => json.push(c),
        }
    }
    json.push('"');
}

/// Key of a domain's metadata with the public key of its successor.
pub const SUCCESSOR: &str = "successor";

/// Kinds of entities, other than domains, whose metadata is the kind alone.
pub const ENTITY_KINDS: [&str; 5] = ["switch", "proxy", "rib", "tool", "owner"];

/// Returns the metadata of a domain. They may name the key that succeeds the owner's when that is
/// lost.
pub fn domain_metadata(successor: Option<&VerifyKey>) -> Metadata {
    let kind = ("kind".to_owned(), "domain".to_owned());
    let successor = successor.map(|key| (SUCCESSOR.to_owned(), key.to_string()));
    [kind].into_iter().chain(successor).collect()
}

/// Proof of a name's derivation that does not reveal the metadata.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NameProof {
    /// Public key of the owner, SEC1 compressed.
    #[serde(with = "crate::cbor::array")]
    pub owner_key: [u8; PUBLIC_KEY_LEN],
    #[serde(with = "crate::cbor::array")]
    pub digest: [u8; 32],
}

impl NameProof {
    /// Whether `key` signs for this name: it is the owner's, or the name is of a domain whose
    /// metadata name it as successor.
    pub fn is_signer(&self, key: &VerifyKey) -> bool {
        *key.as_bytes() == self.owner_key || inner_digest(&domain_metadata(Some(key))) == self.digest
    }

    /// Returns the kind of the entity whose metadata has this digest, if it is a known one other
    /// than a domain. A domain's digest may commit to a successor that only the domain's card
    /// reveals, so no other digest can be ruled out.
    pub fn kind_but_domain(&self) -> Option<&'static str> {
        let is_of = |kind: &&str| inner_digest(&Metadata::from([("kind".to_owned(), (*kind).to_owned())]));
        ENTITY_KINDS.into_iter().find(|kind| is_of(kind) == self.digest)
    }

    /// Returns the proven name. Refuses an owner key that is not a point on the curve, because
    /// nobody could sign for its names.
    pub fn name(&self) -> Result<Name, CryptoError> {
        self.verify_key()?;
        Ok(derive(&self.owner_key, &self.digest))
    }

    /// Returns the owner's key, which verifies certificates about the name.
    pub fn verify_key(&self) -> Result<VerifyKey, CryptoError> {
        VerifyKey::from_bytes(&self.owner_key)
    }
}

impl fmt::Debug for NameProof {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "NameProof {{ owner_key: {}, digest: {} }}", hex::encode(self.owner_key), hex::encode(self.digest))
    }
}

/// Prefix of a name as a person types it: 1 to 64 hex digits.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct NamePrefix(String);

#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("not the beginning of a name: 1 to 64 hex digits are expected")]
pub struct NamePrefixError;

impl NamePrefix {
    pub fn matches(&self, name: &Name) -> bool {
        name.to_string().starts_with(&self.0)
    }

    /// Returns the name if the prefix is complete.
    pub fn full(&self) -> Option<Name> {
        self.0.parse().ok()
    }

    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl From<Name> for NamePrefix {
    fn from(name: Name) -> Self {
        Self(name.to_string())
    }
}

impl FromStr for NamePrefix {
    type Err = NamePrefixError;

    fn from_str(text: &str) -> Result<Self, NamePrefixError> {
        if (1..=64).contains(&text.len()) && text.bytes().all(|c| c.is_ascii_hexdigit()) {
            Ok(Self(text.to_ascii_lowercase()))
        } else {
            Err(NamePrefixError)
        }
    }
}

impl TryFrom<String> for NamePrefix {
    type Error = NamePrefixError;

    fn try_from(text: String) -> Result<Self, NamePrefixError> {
        text.parse()
    }
}

impl From<NamePrefix> for String {
    fn from(prefix: NamePrefix) -> Self {
        prefix.0
    }
}

impl fmt::Display for NamePrefix {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
#[path = "../tests/unit/name.rs"]
mod tests;
