//! What a daemon knows of its trust domain, without I/O: whom it takes links with ([`Trust`]), and whom invitations have admitted.
//! [`crate::serve::domain`] reads and keeps the files, asks and tells others; the links are judged in [`crate::serve::core`].

use std::collections::BTreeMap;

use gdp_core::cert::Invite;
use gdp_wire::Name;
use serde::{Deserialize, Serialize};

pub use gdp_core::domain::{Admission, DomainError, Papers, Standing, Trust};

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

/// The invitations of the own domain that were used. The RIB decides by them, switches remember what it decided.
#[derive(Debug, Default)]
pub struct Invitations(BTreeMap<u64, Used>);

/// Why an invitation does not admit an entity.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotInvited {
    #[error(
        "the invitation with serial {serial} has admitted {by:#}, and it admits one: have another made with `gdp-ctl domain invite`"
    )]
    Used { serial: u64, by: Name },
    #[error(
        "the invitation with serial {serial} ended at Unix time {at} without having been used, now is {now}: have another made"
    )]
    TooLate { serial: u64, at: u64, now: u64 },
    #[error(
        "{MAX_USED} members by invitation, and that is the limit of this RIB: have them admitted with `gdp-ctl domain admit`"
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

    /// As the RIB decides: the first entity is admitted, while the invitation holds. Whether that is new.
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
mod tests {
    use super::*;
    use gdp_core::identity::SigningKey;

    #[test]
    fn the_first_entity_is_admitted_and_no_other() {
        let key = SigningKey::generate().unwrap().verify_key();
        let [robot, thief] = [1, 2].map(|n| Name::from_bytes([n; 32]));
        let invite = |serial| Invite {
            domain: Name::default(),
            key,
            role: "arm".into(),
            serial,
            not_before: 0,
            not_after: 100,
            member_until: 200,
        };
        let mut invitations = Invitations::default();
        assert_eq!(invitations.admit(&invite(7), robot, 100), Ok(true));
        assert_eq!(invitations.admit(&invite(7), robot, 150), Ok(false), "it is one already");
        let refused = invitations.admit(&invite(7), thief, 50);
        assert_eq!(refused, Err(NotInvited::Used { serial: 7, by: robot }));
        assert_eq!(
            invitations.admit(&invite(8), thief, 101),
            Err(NotInvited::TooLate { serial: 8, at: 100, now: 101 })
        );

        let mut after_a_restart = Invitations::recall(invitations.all().copied());
        assert!(after_a_restart.has_admitted(7, &robot) && !after_a_restart.has_admitted(7, &thief));
        assert!(after_a_restart.admit(&invite(7), thief, 50).is_err());
    }

    #[test]
    fn what_is_remembered_is_bounded_and_ends() {
        let key = SigningKey::generate().unwrap().verify_key();
        let invite = |serial, member_until| Invite {
            domain: Name::default(),
            key,
            role: "arm".into(),
            serial,
            not_before: 0,
            not_after: member_until,
            member_until,
        };
        let mut invitations = Invitations::default();
        for serial in 0..MAX_USED as u64 {
            invitations.remember(&invite(serial, 100), Name::default());
        }
        assert_eq!(invitations.admit(&invite(1 << 20, 300), Name::default(), 100), Err(NotInvited::Full));
        assert_eq!(invitations.admit(&invite(1 << 20, 300), Name::default(), 101), Ok(true));
        assert_eq!(invitations.all().count(), 1);
    }
}
