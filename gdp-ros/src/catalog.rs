//! The list of names that a proxy exposes by itself: what each stands for, and who may read it. It goes sealed, under a name of its own, to those
//! who may read that name; so nobody else learns what a robot has.
//!
//! A catalog lists names of the owner of its own name and no others: an entry has no owner key, so what it names follows from that of the catalog.
//! It is pinned at its publisher, and sent again every [`REFRESH`]; a publisher whose catalog is not heard of for [`LEASE`] is gone.

use std::collections::BTreeSet;
use std::time::Duration;

use gdp::card::CardError;
use gdp::cbor::{self, CborError};
use gdp::cert::{Issued, ReadGrant};
use gdp::name::Metadata;
use gdp::seal::Encoding;
use gdp::{NameCard, VerifyKey};
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

/// Bytes of all entries of one catalog, as [`Entry::size`] counts them: what is around them takes fewer than the rest.
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
    /// That of its card. `kind` is `topic`, `service` or `action`; whoever does not know another one leaves such entries out.
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

    /// Reads what another proxy sent: the names, of which `owner` is the owner, with the grants to read them. These are not verified yet.
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
mod tests {
    use gdp::SigningKey;
    use gdp::cert::{Grantee, issue};

    use super::*;

    #[test]
    fn what_is_listed_is_of_the_owner_and_of_nobody_else() {
        let (owner, other) = (SigningKey::generate().unwrap(), SigningKey::generate().unwrap());
        let card = card(&owner, "/chatter");
        let catalog = Catalog::new(vec![entry(&owner, "/chatter", 2), entry(&owner, "/map", 0)]).unwrap();
        let bytes = catalog.to_bytes().unwrap();
        let listed = Catalog::read(&bytes, owner.verify_key()).unwrap();
        assert_eq!((&listed[0].0, listed[0].1.len(), listed[1].0.get("topic")), (&card, 2, Some("/map")));
        let claims = listed[0].1[0].verify(&listed[0].0.proof(), None, 1).unwrap();
        assert_eq!(claims.name, card.name());

        // Read as another owner's, they are other names, for which the grants are worth nothing.
        let stolen = Catalog::read(&bytes, other.verify_key()).unwrap();
        assert_ne!(stolen[0].0.name(), card.name());
        stolen[0].1[0].verify(&stolen[0].0.proof(), None, 1).unwrap_err();
    }

    #[test]
    fn what_is_no_catalog_or_too_much_is_refused() {
        let owner = SigningKey::generate().unwrap();
        let key = owner.verify_key();
        let read = |catalog: &Catalog| Catalog::read(&catalog.to_bytes().unwrap(), key);
        let of = |entries| Catalog { version: VERSION, entries };
        let good = of(vec![entry(&owner, "/a", 1)]);
        assert_eq!(read(&good).unwrap().len(), 1);
        let twice = read(&of([good.entries.clone(), good.entries.clone()].concat())).unwrap_err();
        assert!(matches!(twice, CatalogError::Twice(_)), "{twice}");
        let version = read(&Catalog { version: 2, ..good.clone() }).unwrap_err();
        assert!(matches!(version, CatalogError::Version(2)), "{version}");

        let empty = |topic: String| Entry { metadata: Metadata::from([("topic".into(), topic)]), grants: vec![] };
        let many = (0..=MAX_ENTRIES).map(|i| empty(i.to_string())).collect();
        assert!(matches!(read(&of(many)), Err(CatalogError::TooMuch { what: "names", .. })));
        let grants = vec![good.entries[0].grants[0].clone(); MAX_GRANTS + 1];
        let crowded = of(vec![Entry { grants, ..good.entries[0].clone() }]);
        assert!(matches!(read(&crowded), Err(CatalogError::TooMuch { what: "grants of a name", .. })));
        assert!(Catalog::new(crowded.entries).is_err());
        assert!(matches!(read(&of(vec![empty("x".repeat(5000))])), Err(CatalogError::Card(_))));

        let bytes = good.to_bytes().unwrap();
        for length in 0..bytes.len() {
            Catalog::read(&bytes[..length], key).unwrap_err();
        }
        // Whatever is changed on the way is refused, or leads to other names or to grants that are worth nothing.
        for at in 0..bytes.len() {
            let mut changed = bytes.clone();
            changed[at] ^= 1;
            let Ok(listed) = Catalog::read(&changed, key) else { continue };
            let holds =
                |(card, grants): &Listing| grants.iter().any(|grant| grant.verify(&card.proof(), None, 1).is_ok());
            assert!(!listed.iter().any(holds), "byte {at}");
        }
        Catalog::read(&vec![0; MAX_CATALOG + 1], key).unwrap_err();
    }

    fn card(owner: &SigningKey, topic: &str) -> NameCard {
        let nonce = Some("n".into());
        NameCard::create(owner.verify_key(), "topic", topic, "std_msgs/msg/String", nonce).unwrap()
    }

    fn entry(owner: &SigningKey, topic: &str, grants: u64) -> Entry {
        let card = card(owner, topic);
        let grant = |serial| {
            let (name, to) = (card.name(), Grantee::Entity(card.name()));
            issue(owner, &ReadGrant { name, to, serial, not_before: 0, not_after: u64::MAX }).unwrap().into()
        };
        Entry { metadata: card.metadata().clone(), grants: (0..grants).map(grant).collect() }
    }
}
