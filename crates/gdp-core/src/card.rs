//! Name cards: JSON files with the metadata from which a name is derived. Anyone who has the card
//! can derive the name. A card is not a secret key, but it reveals the topic, so it is given only
//! to those who may know it.

use crate::crypto::CryptoError;
use crate::file_kind::FileKind;
use crate::name::{Metadata, Name, NameProof};
use crate::verify_key::VerifyKey;
use crate::{crypto, name};
use gdp_util::{os, text_file};
use serde::{Deserialize, Deserializer, Serialize, de};
use std::fmt;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

const VERSION: u32 = 1;
const MAX_FILE: usize = 64 * 1024;
const MAX_ENTRIES: usize = 64;
const MAX_KEY: usize = 128;
const MAX_VALUE: usize = 4096;

#[derive(Debug, thiserror::Error)]
pub enum CardError {
    #[error("{}: cannot {action}: {source}", path.display())]
    Io { path: PathBuf, action: &'static str, source: io::Error },
    #[error("{}: longer than {MAX_FILE} bytes, so not a name card", .0.display())]
    TooLong(PathBuf),
    #[error("not a name card: {0}")]
    Malformed(String),
    #[error("the card says its name is {stated}, but its content derives {derived}: it was changed after it was made")]
    WrongName { stated: Name, derived: Name },
    #[error("{0}")]
    Bounds(String),
    #[error(transparent)]
    Crypto(#[from] CryptoError),
}

/// Owner key and metadata of one name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NameCard {
    owner_key: VerifyKey,
    metadata: Metadata,
}

impl NameCard {
    /// Creates a card with exactly this metadata. Refuses metadata that exceeds the limits of a
    /// card.
    pub fn new(owner_key: VerifyKey, metadata: Metadata) -> Result<Self, CardError> {
        let refuse = |reason: String| Err(CardError::Bounds(reason));
        if metadata.len() > MAX_ENTRIES {
            return refuse(format!("{} metadata entries where at most {MAX_ENTRIES} are allowed", metadata.len()));
        }
        for (key, value) in &metadata {
            if key.is_empty() || key.len() > MAX_KEY {
                return refuse(format!("metadata key of {} bytes where 1 to {MAX_KEY} are allowed", key.len()));
            }
            if value.len() > MAX_VALUE {
                return refuse(format!(
                    "metadata value {key:?} of {} bytes where at most {MAX_VALUE} are allowed",
                    value.len()
                ));
            }
        }
        Ok(Self { owner_key, metadata })
    }

    /// Creates the card of a topic, service or action.
    ///
    /// `kind` is `topic`, …; `type_name` is, for ROS 2, `std_msgs/msg/String`. Without a `nonce`,
    /// 128 random bits are drawn. A memorable nonce lets others guess what the name stands for.
    pub fn create(
        owner_key: VerifyKey,
        kind: &str,
        topic: &str,
        type_name: &str,
        nonce: Option<String>,
    ) -> Result<Self, CardError> {
        let nonce = match nonce {
            Some(nonce) => nonce,
            None => hex::encode(crypto::random::<16>()?),
        };
        let entries = [("kind", kind), ("topic", topic), ("type", type_name), ("nonce", &nonce)];
        Self::new(owner_key, entries.map(|(key, value)| (key.to_owned(), value.to_owned())).into())
    }

    pub fn name(&self) -> Name {
        let proof = self.proof();
        name::derive(&proof.owner_key, &proof.digest)
    }

    pub fn proof(&self) -> NameProof {
        NameProof { owner_key: *self.owner_key.as_bytes(), digest: name::inner_digest(&self.metadata) }
    }

    /// Returns the key that a domain's card names as the successor of its owner's.
    pub fn successor(&self) -> Option<VerifyKey> {
        self.metadata.get(name::SUCCESSOR)?.parse().ok()
    }

    /// Returns whether the metadata is that of a domain, with or without a successor.
    pub fn is_domain(&self) -> bool {
        self.metadata == name::domain_metadata(self.successor().as_ref())
    }

    pub fn owner_key(&self) -> &VerifyKey {
        &self.owner_key
    }

    pub fn metadata(&self) -> &Metadata {
        &self.metadata
    }

    /// Returns one metadata value, such as `topic`.
    pub fn get(&self, key: &str) -> Option<&str> {
        self.metadata.get(key).map(String::as_str)
    }

    pub fn from_json(text: &str) -> Result<Self, CardError> {
        if text.len() > MAX_FILE {
            return Err(CardError::Malformed(format!("longer than {MAX_FILE} bytes")));
        }
        let file: CardFile = serde_json::from_str(text).map_err(|error| {
            let made = "a name card is the JSON file that `gdp-ctl name create` makes";
            CardError::Malformed(match FileKind::of(text) {
                Some(kind) if kind != FileKind::Card => format!("it is {kind}; {made}"),
                None if !text.trim_start().starts_with('{') => made.to_owned(),
                _ => error.to_string(),
            })
        })?;
        if file.version != VERSION {
            let version = file.version;
            return Err(CardError::Malformed(format!("version {version}, but this program knows version {VERSION}")));
        }
        let card = Self::new(file.owner_key, file.metadata.0)?;
        if card.name() != file.name {
            return Err(CardError::WrongName { stated: file.name, derived: card.name() });
        }
        Ok(card)
    }

    pub fn to_json(&self) -> String {
        let file = CardFile {
            version: VERSION,
            name: self.name(),
            owner_key: self.owner_key,
            metadata: UniqueMap(self.metadata.clone()),
        };
        let mut text = serde_json::to_string_pretty(&file).expect("strings and numbers always have a JSON form");
        text.push('\n');
        text
    }

    pub fn load(path: &Path) -> Result<Self, CardError> {
        let io = |action| move |source| CardError::Io { path: path.into(), action, source };
        let text = text_file::read(path, MAX_FILE as u64).map_err(io("read"))?;
        let text = text.ok_or_else(|| CardError::TooLong(path.into()))?;
        Self::from_json(&text).map_err(|error| match error {
            CardError::Malformed(reason) => CardError::Malformed(format!("{}: {reason}", path.display())),
            CardError::Bounds(reason) => CardError::Bounds(format!("{}: {reason}", path.display())),
            other => other,
        })
    }

    /// Writes a new file that only its owner can read, because the card reveals the topic. Never
    /// overwrites an existing file.
    pub fn save_new(&self, path: &Path) -> Result<(), CardError> {
        let io = |action| move |source| CardError::Io { path: path.into(), action, source };
        let mut file = os::create_private(path).map_err(io("create"))?;
        file.write_all(self.to_json().as_bytes()).map_err(io("write"))
    }
}

/// JSON form of a card. `name` is redundant: it lets people find the card and reveals damage.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct CardFile {
    version: u32,
    name: Name,
    owner_key: VerifyKey,
    metadata: UniqueMap,
}

/// Map that refuses duplicate keys. Two readers could otherwise derive two names from one card.
#[derive(Serialize)]
#[serde(transparent)]
struct UniqueMap(Metadata);

impl<'de> Deserialize<'de> for UniqueMap {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(UniqueMapVisitor)
    }
}

struct UniqueMapVisitor;

impl<'de> de::Visitor<'de> for UniqueMapVisitor {
    type Value = UniqueMap;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a map of strings")
    }

    fn visit_map<A: de::MapAccess<'de>>(self, mut access: A) -> Result<UniqueMap, A::Error> {
        let mut map = Metadata::new();
        while let Some((key, value)) = access.next_entry::<String, String>()? {
            if map.contains_key(&key) {
                return Err(de::Error::custom(format_args!("metadata key {key:?} occurs twice")));
            }
            map.insert(key, value);
        }
        Ok(UniqueMap(map))
    }
}

#[cfg(test)]
#[path = "../tests/unit/card.rs"]
mod tests;
