//! The catalog of a proxy: the names that it exposes, the meaning of each, and its readers. A proxy
//! publishes its catalog sealed, under a name of its own. Only readers of that name learn what a
//! robot exposes.
//!
//! A catalog lists only names that have the same owner as its own name, so entries have no owner
//! key. The proxy pins the catalog at its publisher, and sends it again every [`REFRESH`]. A reader
//! that receives no catalog for [`LEASE`] drops that publisher.

use std::collections::BTreeSet;
use std::time::Duration;

use gdp_core::card::{CardError, NameCard};
use gdp_core::cbor;
use gdp_core::cbor::CborError;
use gdp_core::cert::{Grantee, Issued, Membership, ReadGrant, Reading};
use gdp_core::identity::VerifyKey;
use gdp_core::name::Metadata;
use gdp_e2e::seal::Encoding;
use gdp_wire::Name;
use serde::{Deserialize, Serialize};

/// Encoding number of a message that is a catalog.
pub const CATALOG: Encoding = Encoding::Other(0x4743);

/// Interval between two catalogs if nothing changes.
pub const REFRESH: Duration = Duration::from_secs(10);

/// Time after which a catalog expires.
pub const LEASE: Duration = Duration::from_secs(35);

/// Maximum number of names in one catalog.
pub const MAX_ENTRIES: usize = 1024;

/// Maximum number of read grants for one name.
pub const MAX_GRANTS: usize = 64;

/// Maximum size of an encoded catalog, in bytes.
const MAX_CATALOG: usize = 4 << 20;

/// Maximum size of all entries of one catalog, in bytes, as [`Entry::size`] counts them. The rest
/// of a catalog takes fewer than the 64 bytes left.
pub const MAX_ENTRY_BYTES: usize = MAX_CATALOG - 64;

const VERSION: u8 = 1;

/// All names that a proxy exposes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Catalog {
    version: u8,
    pub entries: Vec<Entry>,
}

/// One name of a catalog.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    /// The metadata of the name's card. `kind` is `topic`, `service` or `action`. Readers skip
    /// entries of a kind that they do not know.
    pub metadata: Metadata,
    /// The read grants of all entities that may read or call the name.
    pub grants: Vec<Issued<ReadGrant>>,
}

impl Entry {
    /// Returns the encoded size of the entry, in bytes.
    pub fn size(&self) -> Result<usize, CborError> {
        Ok(cbor::encode(self)?.len())
    }
}

/// A name's card with its read grants.
pub type Listing = (NameCard, Vec<Issued<ReadGrant>>);

/// Returns the first grant of a listed name by which `entity` may read or call it at `now` (Unix
/// seconds). `member` proves the entity's role.
pub fn right_of(
    card: &NameCard,
    grants: Vec<Issued<ReadGrant>>,
    entity: Name,
    member: Option<&Membership>,
    now: u64,
) -> Option<Reading> {
    let proof = card.proof();
    let shown = |grant: Issued<ReadGrant>| {
        let member = match grant.cert.claims_unverified().ok()?.to {
            Grantee::Entity(to) if to == entity => None,
            Grantee::Entity(_) => return None,
            Grantee::Role { .. } => Some(Box::new(member?.clone())),
        };
        let reading = Reading { grant, member };
        reading.verify(&proof, entity, None, now).is_ok().then_some(reading)
    };
    grants.into_iter().find_map(shown)
}

/// The reason why a catalog is refused.
#[derive(Debug, thiserror::Error)]
pub enum CatalogError {
    #[error(transparent)]
    Cbor(#[from] CborError),
    #[error("a catalog of version {0}, which this release does not know; update the proxy")]
    Version(u8),
    #[error("{what}: {got} where at most {most} are allowed")]
    TooMuch { what: &'static str, got: usize, most: usize },
    #[error("an entry is no name: {0}")]
    Card(#[from] CardError),
    #[error("the name {0} is listed twice")]
    Twice(String),
}

impl Catalog {
    /// Creates a catalog. Fails if it exceeds [`MAX_ENTRIES`] or [`MAX_GRANTS`].
    pub fn new(entries: Vec<Entry>) -> Result<Self, CatalogError> {
        let catalog = Self { version: VERSION, entries };
        catalog.check()?;
        Ok(catalog)
    }

    /// Encodes the catalog. Fails if it exceeds 4 MiB.
    pub fn to_bytes(&self) -> Result<Vec<u8>, CatalogError> {
        let bytes = cbor::encode(self)?;
        match bytes.len() {
            got if got > MAX_CATALOG => Err(CatalogError::TooMuch { what: "bytes", got, most: MAX_CATALOG }),
            _ => Ok(bytes),
        }
    }

    /// Decodes a catalog from another proxy. Returns the card of each name, with `owner` as its
    /// owner, and its read grants. The caller must verify the grants.
    pub fn read(bytes: &[u8], owner: VerifyKey) -> Result<Vec<Listing>, CatalogError> {
        let catalog: Self = cbor::decode(bytes, MAX_CATALOG)?;
        if catalog.version != VERSION {
            return Err(CatalogError::Version(catalog.version));
        }
        catalog.check()?;
        let mut names = BTreeSet::new();
        let mut listed = Vec::with_capacity(catalog.entries.len());
        for Entry { metadata, grants } in catalog.entries {
            let card = NameCard::new(owner, metadata)?;
            if !names.insert(card.name()) {
                return Err(CatalogError::Twice(card.name().to_string()));
            }
            listed.push((card, grants));
        }
        Ok(listed)
    }

    fn check(&self) -> Result<(), CatalogError> {
        let grants = self.entries.iter().map(|entry| entry.grants.len()).max().unwrap_or(0);
        let bounds = [("names", self.entries.len(), MAX_ENTRIES), ("grants of a name", grants, MAX_GRANTS)];
        match bounds.into_iter().find(|(_, got, most)| got > most) {
            Some((what, got, most)) => Err(CatalogError::TooMuch { what, got, most }),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
#[path = "../tests/unit/catalog.rs"]
mod tests;
