//! The directory as it is sent, and as a member reads it.

use gdp_core::card::{CardError, NameCard};
use gdp_core::cbor;
use gdp_core::cbor::CborError;
use gdp_core::cert::enrollment::within_namespace;
use gdp_core::cert::{Enrollment, Issued, Membership, ReadGrant, Signed};
use gdp_core::identity::VerifyKey;
use gdp_core::name::Metadata;
use gdp_wire::Name;
use serde::{Deserialize, Serialize};

/// Maximum number of members.
pub const MAX_MEMBERS: usize = 1024;

/// Maximum size of an encoded directory, in bytes.
pub const MAX_DIRECTORY: usize = 4 << 20;

/// Maximum size of a catalog's metadata, in bytes.
pub const MAX_METADATA: usize = 1024;

const VERSION: u8 = 1;

/// All members that the join service has enrolled.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Directory {
    version: u8,
    pub entries: Vec<MemberEntry>,
}

/// One member of the directory.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MemberEntry {
    pub membership: Membership,
    pub enrollment: Signed<Enrollment>,
    /// The name of the member's catalog, if it exposes anything.
    pub catalog: Option<CatalogName>,
    /// Grants for the catalog, one for each member that may read it.
    pub grants: Vec<Issued<ReadGrant>>,
}

/// Owner and metadata of a catalog's name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CatalogName {
    pub owner: VerifyKey,
    pub metadata: Metadata,
}

impl CatalogName {
    pub fn card(&self) -> Result<NameCard, CardError> {
        NameCard::new(self.owner, self.metadata.clone())
    }
}

impl From<&NameCard> for CatalogName {
    fn from(card: &NameCard) -> Self {
        Self { owner: *card.owner_key(), metadata: card.metadata().clone() }
    }
}

/// Member whose certificates hold.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Member {
    pub entity: Name,
    pub enrollment: Enrollment,
    pub catalog: Option<NameCard>,
    /// The grant of the reader of this directory for the catalog.
    pub grant: Option<Issued<ReadGrant>>,
}

/// The reason why a directory is refused.
#[derive(Debug, thiserror::Error)]
pub enum DirectoryError {
    #[error(transparent)]
    Cbor(#[from] CborError),
    #[error("a directory of version {0}, which this release does not know; update this machine")]
    Version(u8),
    #[error("{0} members where at most {MAX_MEMBERS} are allowed")]
    TooMany(usize),
    #[error("a directory of {0} bytes where at most {MAX_DIRECTORY} are allowed")]
    TooLong(usize),
}

impl Directory {
    pub fn new(entries: Vec<MemberEntry>) -> Self {
        Self { version: VERSION, entries }
    }

    pub fn to_bytes(&self) -> Result<Vec<u8>, DirectoryError> {
        let bytes = cbor::encode(self)?;
        if bytes.len() > MAX_DIRECTORY { Err(DirectoryError::TooLong(bytes.len())) } else { Ok(bytes) }
    }

    pub fn from_bytes(bytes: &[u8]) -> Result<Self, DirectoryError> {
        let directory: Self = cbor::decode(bytes, MAX_DIRECTORY)?;
        match directory.entries.len() {
            _ if directory.version != VERSION => Err(DirectoryError::Version(directory.version)),
            count if count > MAX_MEMBERS => Err(DirectoryError::TooMany(count)),
            _ => Ok(directory),
        }
    }

    /// Returns the members whose certificates hold in `domain` at `now` (Unix seconds), with the
    /// grants of `reader`. Of several members with one label, the one enrolled last counts.
    ///
    /// The caller trusts the publisher of the directory for revocations, and for which entity was
    /// the first to use an invitation.
    pub fn members(&self, domain: Name, reader: Name, now: u64) -> Vec<Member> {
        let mut members: Vec<Member> =
            self.entries.iter().filter_map(|entry| entry.member(domain, reader, now)).collect();
        let key = |member: &Member| (member.enrollment.label.clone(), std::cmp::Reverse(member.enrollment.serial));
        members.sort_by_key(key);
        members.dedup_by(|later, first| later.enrollment.label == first.enrollment.label);
        members
    }

    /// Returns the newest membership of `entity` in `domain` that holds at `now` (Unix seconds).
    pub fn membership_of(&self, entity: Name, domain: Name, now: u64) -> Option<&Membership> {
        let is_of = |membership: &&Membership| {
            let stated = membership.cert.claims_unverified().is_ok_and(|claims| claims.entity == entity);
            stated && membership.verify(domain, None, now).is_ok_and(|claims| claims.entity == entity)
        };
        let memberships = self.entries.iter().map(|entry| &entry.membership).filter(is_of);
        memberships.max_by_key(|membership| membership.serial_unverified().unwrap_or_default())
    }
}

impl MemberEntry {
    fn member(&self, domain: Name, reader: Name, now: u64) -> Option<Member> {
        let (entity, enrollment) = self.enrollment.verify_for(domain, &self.membership, now).ok()?;
        let catalog = self.catalog.as_ref().and_then(|catalog| catalog.card().ok());
        let is_own = |grant: &&Issued<ReadGrant>| {
            grant.cert.claims_unverified().is_ok_and(|claims| claims.to == super::entity(reader))
        };
        let holds = |grant: &&Issued<ReadGrant>| {
            catalog.as_ref().is_some_and(|catalog| grant.verify(&catalog.proof(), None, now).is_ok())
        };
        // One grant for each reader, so that a hostile publisher causes no more work.
        let grant = self.grants.iter().take(MAX_MEMBERS).find(is_own).filter(holds).cloned();
        Some(Member { entity, enrollment, catalog, grant })
    }
}

impl Member {
    /// Returns the patterns of this member's topics that `reader` may read, with their names in
    /// this member's catalog.
    pub fn readable_by(&self, reader: &Enrollment) -> Vec<String> {
        let read = reader.read.iter().filter(|of| of.is_of(&self.enrollment.label)).flat_map(|of| of.topics.clone());
        read.chain(self.imported_by(reader).map(|(at_member, _)| at_member)).collect()
    }

    /// Returns the patterns of the topics that `reader` imports from this member under its own
    /// names: first as this member has them, then as the reader has them.
    pub fn imported_by<'a>(&'a self, reader: &'a Enrollment) -> impl Iterator<Item = (String, &'a str)> {
        let from = reader.import.iter().filter(|of| of.is_of(&self.enrollment.label));
        let label = &reader.label;
        from.flat_map(move |of| of.topics.iter().map(move |topic| (within_namespace(label, topic), topic.as_str())))
    }
}
