//! The catalog of a proxy: the names that it exposes, the meaning of each, and its readers. A
//! catalog is published sealed under a name of its own. Only entities that may read that name learn
//! what a robot has.
//!
//! A catalog lists names of the owner of its own name and no others: an entry has no owner key, so
//! what it names follows from that of the catalog. It is pinned at its publisher, and sent again
//! every [`REFRESH`]; a publisher whose catalog is not heard of for [`LEASE`] is gone.

use std::collections::BTreeSet;
use std::time::Duration;

use gdp_core::card::{CardError, NameCard};
use gdp_core::cbor;
use gdp_core::cbor::CborError;
use gdp_core::cert::{Issued, ReadGrant};
use gdp_core::identity::VerifyKey;
use gdp_core::name::Metadata;
use gdp_e2e::seal::Encoding;
use serde::{Deserialize, Serialize};

/// How a message is marked that is a catalog.
pub const CATALOG: Encoding = Encoding::Other(0x4743);

/// How often it is sent, if nothing changes.
pub const REFRESH: Duration = Duration::from_secs(10);

/// For how long it holds.
pub const LEASE: Duration = Duration::from_secs(35);

/// Names of one catalog.
pub const MAX_ENTRIES: usize = 1024;

/// Grants to read one of its names.
pub const MAX_GRANTS: usize = 64;

/// In bytes.
const MAX_CATALOG: usize = 4 << 20;

/// Bytes of all entries of one catalog, as [`Entry::size`] counts them: what is around them takes
/// fewer than the rest.
pub const MAX_ENTRY_BYTES: usize = MAX_CATALOG - 64;

const VERSION: u8 = 1;

/// All that a proxy exposes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Catalog {
    version: u8,
    pub entries: Vec<Entry>,
}

/// A name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    /// That of its card. `kind` is `topic`, `service` or `action`; whoever does not know another
    /// one leaves such entries out.
    pub metadata: Metadata,
    /// Everybody's who may read or call it.
    pub grants: Vec<Issued<ReadGrant>>,
}

impl Entry {
    /// Bytes that it takes in a catalog.
    pub fn size(&self) -> Result<usize, CborError> {
        Ok(cbor::encode(self)?.len())
    }
}

/// A name with the grants to read it.
pub type Listing = (NameCard, Vec<Issued<ReadGrant>>);

/// Why a catalog is not taken.
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
    /// Refused if it has more than a reader takes.
    pub fn new(entries: Vec<Entry>) -> Result<Self, CatalogError> {
        let catalog = Self { version: VERSION, entries };
        catalog.check()?;
        Ok(catalog)
    }

    /// Likewise refused.
    pub fn to_bytes(&self) -> Result<Vec<u8>, CatalogError> {
        let bytes = cbor::encode(self)?;
        match bytes.len() {
            got if got > MAX_CATALOG => Err(CatalogError::TooMuch { what: "bytes", got, most: MAX_CATALOG }),
            _ => Ok(bytes),
        }
    }

    /// Reads what another proxy sent: the names, of which `owner` is the owner, with the grants to
    /// read them. These are not verified yet.
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
