//! The entries of remote catalogs that this proxy may read.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

use gdp_core::card::NameCard;
use gdp_core::cert::{Issued, Membership, ReadGrant, Reading};
use gdp_core::identity::VerifyKey;
use gdp_e2e::seal::Message;
use gdp_ros::catalog::{Catalog, CatalogError, LEASE, right_of};
use gdp_wire::Name;

use crate::config::{ImportConfig, Thing};
use crate::ros2::{TopicName, TypeName};

/// Bound on the writers of one catalog. Further ones are refused.
const MAX_WRITERS: usize = 16;

/// Seconds after which an unchanged catalog is verified again, because certificates expire and
/// memberships are renewed.
const AGAIN: u64 = 600;

/// An entity of a catalog that this proxy may read or call.
#[derive(Clone, Debug, PartialEq)]
pub struct Listed {
    pub card: NameCard,
    pub thing: Thing,
    /// Its name in the remote graph.
    pub name: TopicName,
    /// The ROS type. Topics always have one.
    pub kind: Option<TypeName>,
    pub right: Reading,
}

/// The catalogs of one name, one for each writer.
pub struct Catalogs {
    owner: VerifyKey,
    /// The proxy's own name.
    entity: Name,
    writers: BTreeMap<Name, ReceivedCatalog>,
}

struct ReceivedCatalog {
    session: [u8; 16],
    sequence: u64,
    until: Instant,
    body: bytes::Bytes,
    /// Time of the last verification in Unix seconds.
    verified: u64,
    listed: Vec<Listed>,
}

impl Catalogs {
    pub fn new(owner: VerifyKey, entity: Name) -> Self {
        Self { owner, entity, writers: BTreeMap::new() }
    }

    /// Receives a catalog message. `member` returns the membership that proves this proxy's role.
    /// `now_unix` is in seconds. Returns true if the entries changed.
    pub fn take(
        &mut self,
        message: &Message,
        member: impl FnOnce() -> Option<Membership>,
        now: Instant,
        now_unix: u64,
    ) -> Result<bool, CatalogError> {
        if message.writer == self.entity {
            return Ok(false);
        }
        let before = self.writers.get_mut(&message.writer);
        let mut known = None;
        if let Some(received) = before {
            if received.session == message.session && received.sequence > message.sequence {
                return Ok(false);
            }
            (received.session, received.sequence, received.until) = (message.session, message.sequence, now + LEASE);
            if received.body == message.body
                && (received.verified..received.verified.saturating_add(AGAIN)).contains(&now_unix)
            {
                return Ok(false);
            }
            known = Some(received.listed.clone());
        } else if self.writers.len() >= MAX_WRITERS {
            return Err(CatalogError::TooMuch { what: "writers", got: MAX_WRITERS + 1, most: MAX_WRITERS });
        }
        let member = member();
        let names = Catalog::read(&message.body, self.owner)?.into_iter();
        let listed = names.filter_map(|(card, grants)| self.listed(card, grants, member.as_ref(), now_unix));
        let listed: Vec<Listed> = listed.collect();
        let is_new = known.as_ref() != Some(&listed);
        let (session, sequence, until, body) = (message.session, message.sequence, now + LEASE, message.body.clone());
        self.writers
            .insert(message.writer, ReceivedCatalog { session, sequence, until, body, verified: now_unix, listed });
        Ok(is_new)
    }

    /// Forgets silent writers. Returns true if there were any.
    pub fn poll(&mut self, now: Instant) -> bool {
        let before = self.writers.len();
        self.writers.retain(|_, received| now < received.until);
        before != self.writers.len()
    }

    /// Returns all entries, each name once.
    pub fn all(&self) -> Vec<Listed> {
        let mut names = BTreeSet::new();
        let listed = self.writers.values().flat_map(|received| &received.listed);
        listed.filter(|listed| names.insert(listed.card.name())).cloned().collect()
    }

    /// Returns the entry with its first grant that is valid for this proxy. Kinds of names that
    /// this release does not know are skipped.
    fn listed(
        &self,
        card: NameCard,
        grants: Vec<Issued<ReadGrant>>,
        member: Option<&Membership>,
        now_unix: u64,
    ) -> Option<Listed> {
        let thing = Thing::parse(card.get("kind")?)?;
        let name = TopicName::parse(card.get("topic")?).ok()?;
        let kind = card.get("type").filter(|text| !text.is_empty()).map(TypeName::parse).transpose().ok()?;
        if !thing.fits(kind.as_ref()) {
            return None;
        }
        let right = right_of(&card, grants, self.entity, member, now_unix)?;
        Some(Listed { card, thing, name, kind, right })
    }
}

/// Returns the imported entries with their names in this graph. Of several entries with one name,
/// the first is used.
pub fn chosen<'a>(config: &ImportConfig, listed: &'a [Listed]) -> BTreeMap<(Thing, TopicName), &'a Listed> {
    let mut chosen = BTreeMap::new();
    for listed in listed.iter().filter(|listed| config.wants(listed.thing, &listed.name)) {
        if let Some(name) = config.local_name(listed.thing, &listed.name) {
            chosen.entry((listed.thing, name)).or_insert(listed);
        }
    }
    chosen
}

#[cfg(test)]
#[path = "../../tests/unit/automatic/listed.rs"]
mod tests;
