//! The state of a daemon's trust domain, without I/O: the rules for links ([`Trust`]) and the
//! admissions by invitation. `serve::domain` reads the files, asks the RIB and floods revocations.
//! `serve::core` admits the peers of links.

use std::collections::BTreeMap;

use gdp_core::cert::Invite;
use gdp_core::cert::domain::roles;
use gdp_util::date::relative;
use gdp_wire::Name;
use serde::{Deserialize, Serialize};

pub use gdp_core::domain::{Admission, Credentials, DomainError, Relationship, Trust};

/// The maximum number of used invitations whose members may still be valid.
pub const MAX_USED: usize = 16_384;

/// A daemon's membership of a domain.
#[derive(Debug)]
pub struct Domain {
    pub trust: Trust,
    pub invitations: Invitations,
    /// The number of changes so far that must survive a restart.
    pub changes: u64,
}

impl Domain {
    pub fn new(trust: Trust, invitations: Invitations) -> Self {
        Self { trust, invitations, changes: 0 }
    }
}

/// The admission of an entity by an invitation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Used {
    pub serial: u64,
    pub entity: Name,
    /// The end of the entity's membership by the invitation, in Unix seconds.
    pub until: u64,
}

/// The membership that an entity shows with an invitation.
#[derive(Clone, Copy, Debug)]
pub struct Admitted {
    pub entity: Name,
    /// The end of the membership in Unix seconds.
    pub until: u64,
}

/// The used invitations of this domain. The RIB decides by them, and switches cache its decisions.
#[derive(Debug, Default)]
pub struct Invitations(BTreeMap<u64, Used>);

/// The reason why an invitation does not admit an entity.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotInvited {
    #[error(
        "the invitation with serial {serial} has admitted {by:#}, and it admits one: have another made with `gdp-ctl \
         domain invite`"
    )]
    Used { serial: u64, by: Name },
    #[error(
        "the invitation with serial {serial} ended {} without having been used: have another made",
        relative(*at, *now)
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

    /// Returns whether this invitation is known to have admitted this entity until this time.
    pub fn has_admitted(&self, serial: u64, entity: &Name, until: u64) -> bool {
        self.0.get(&serial).is_some_and(|used| used.entity == *entity && used.until >= until)
    }

    /// Decides about an admission as the RIB does: a valid invitation admits the first entity, or
    /// every applicant. Returns whether the admission is new or lasts longer than was known.
    pub fn admit(&mut self, invite: &Invite, admitted: Admitted, now: u64) -> Result<bool, NotInvited> {
        let serial = invite.serial;
        if invite.role == roles::APPLICANT {
            return Ok(false);
        }
        match self.0.get(&serial) {
            Some(used) if used.entity == admitted.entity && used.until >= admitted.until => return Ok(false),
            Some(used) if used.entity != admitted.entity => {
                return Err(NotInvited::Used { serial, by: used.entity });
            }
            Some(_) => {}
            None if now > invite.not_after => {
                return Err(NotInvited::TooLate { serial, at: invite.not_after, now });
            }
            None => {}
        }
        self.0.retain(|_, used| used.until >= now);
        if self.0.len() >= MAX_USED && !self.0.contains_key(&serial) {
            return Err(NotInvited::Full);
        }
        self.remember(invite, admitted);
        Ok(true)
    }

    /// Withdraws an admission that could not be stored.
    pub fn forget(&mut self, serial: u64) {
        self.0.remove(&serial);
    }

    /// Records an admission that the RIB has decided.
    pub fn remember(&mut self, invite: &Invite, Admitted { entity, until }: Admitted) {
        self.take(Used { serial: invite.serial, entity, until: until.max(invite.member_until) });
    }

    /// Records a stored admission, if there is room.
    pub fn take(&mut self, used: Used) {
        if self.0.len() < MAX_USED || self.0.contains_key(&used.serial) {
            self.0.insert(used.serial, used);
        }
    }
}

#[cfg(test)]
#[path = "../tests/unit/domain.rs"]
mod tests;
