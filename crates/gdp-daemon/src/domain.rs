//! What a daemon knows of its trust domain, without I/O: whom it takes links with ([`Trust`]), and
//! whom invitations have admitted. `serve::domain` reads the files, asks and tells others;
//! `serve::core` admits the peers of links.

use std::collections::BTreeMap;

use gdp_core::cert::Invite;
use gdp_wire::Name;
use serde::{Deserialize, Serialize};

pub use gdp_core::domain::{Admission, Credentials, DomainError, Relationship, Trust};

/// Invitations that were used and whose members may still be some.
pub const MAX_USED: usize = 16_384;

/// A daemon as a member of a domain.
#[derive(Debug)]
pub struct Domain {
    pub trust: Trust,
    pub invitations: Invitations,
    /// Rises with whatever is to be kept over a restart.
    pub changes: u64,
}

impl Domain {
    pub fn new(trust: Trust, invitations: Invitations) -> Self {
        Self { trust, invitations, changes: 0 }
    }
}

/// Whom an invitation has admitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Used {
    pub serial: u64,
    pub entity: Name,
    /// Unix seconds: until then the entity may be a member by it.
    pub until: u64,
}

/// The invitations of the own domain that were used. The RIB decides by them, switches remember
/// what it decided.
#[derive(Debug, Default)]
pub struct Invitations(BTreeMap<u64, Used>);

/// Why an invitation does not admit an entity.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotInvited {
    #[error(
        "the invitation with serial {serial} has admitted {by:#}, and it admits one: have another made with `gdp-ctl \
         domain invite`"
    )]
    Used { serial: u64, by: Name },
    #[error(
        "the invitation with serial {serial} ended at Unix time {at} without having been used, now is {now}: have \
         another made"
    )]
    TooLate { serial: u64, at: u64, now: u64 },
    #[error(
        "{MAX_USED} members by invitation, and that is the limit of this RIB: have them admitted with `gdp-ctl \
         domain admit`"
    )]
    Full,
}

impl Invitations {
    pub fn recall(used: impl IntoIterator<Item = Used>) -> Self {
        Self(used.into_iter().take(MAX_USED).map(|used| (used.serial, used)).collect())
    }

    pub fn all(&self) -> impl Iterator<Item = &Used> {
        self.0.values()
    }

    pub fn get(&self, serial: u64) -> Option<&Used> {
        self.0.get(&serial)
    }

    /// Whether it is known that this invitation has admitted this entity.
    pub fn has_admitted(&self, serial: u64, entity: &Name) -> bool {
        self.0.get(&serial).is_some_and(|used| used.entity == *entity)
    }

    /// As the RIB decides: the first entity is admitted, while the invitation holds. Whether that
    /// is new.
    pub fn admit(&mut self, invite: &Invite, entity: Name, now: u64) -> Result<bool, NotInvited> {
        let serial = invite.serial;
        match self.0.get(&serial) {
            Some(used) if used.entity == entity => return Ok(false),
            Some(used) => return Err(NotInvited::Used { serial, by: used.entity }),
            None if now > invite.not_after => {
                return Err(NotInvited::TooLate { serial, at: invite.not_after, now });
            }
            None => {}
        }
        self.0.retain(|_, used| used.until >= now);
        if self.0.len() >= MAX_USED {
            return Err(NotInvited::Full);
        }
        self.remember(invite, entity);
        Ok(true)
    }

    /// What was decided could not be kept: it is not so.
    pub fn forget(&mut self, serial: u64) {
        self.0.remove(&serial);
    }

    /// What the RIB has decided.
    pub fn remember(&mut self, invite: &Invite, entity: Name) {
        self.take(Used { serial: invite.serial, entity, until: invite.member_until });
    }

    /// As [`Self::remember`].
    pub fn take(&mut self, used: Used) {
        if self.0.len() < MAX_USED || self.0.contains_key(&used.serial) {
            self.0.insert(used.serial, used);
        }
    }
}

#[cfg(test)]
#[path = "../tests/unit/domain.rs"]
mod tests;
