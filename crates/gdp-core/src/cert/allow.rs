//! Certificates from the key of a name's owner, in one line each.

use std::time::Duration;

use gdp_util::unix_time::{unix_nanos, unix_seconds};

use super::{AdCert, BACKDATED, CertError, Claims as _, Grantee, Issued, ReadGrant, Reading, issue};
use crate::card::NameCard;
use crate::identity::SigningKey;
use crate::name::Name;

const DAY: Duration = Duration::from_secs(24 * 3600);

/// Validity of a certificate whose issuer states none.
const DEFAULT: Duration = Duration::from_secs(365 * 24 * 3600);

impl SigningKey {
    /// Lets an entity publish or serve a name of this owner. [`AllowPublish::sign`] makes the
    /// certificate.
    pub fn allow_publish<'a>(&'a self, card: &'a NameCard, entity: Name) -> AllowPublish<'a> {
        AllowPublish { terms: Terms { owner: self, card, lifetime: DEFAULT }, entity, scope: Vec::new() }
    }

    /// Lets an entity read or call a name of this owner. [`AllowRead::sign`] makes the certificate.
    pub fn allow_read<'a>(&'a self, card: &'a NameCard, entity: Name) -> AllowRead<'a> {
        self.allow_read_by(card, Grantee::Entity(entity))
    }

    /// Lets an entity, or all members of a domain with a role, read or call a name of this owner.
    pub fn allow_read_by<'a>(&'a self, card: &'a NameCard, to: Grantee) -> AllowRead<'a> {
        AllowRead { terms: Terms { owner: self, card, lifetime: DEFAULT }, to }
    }
}

/// The certificate by which an entity may publish or serve a name, before it is signed. Valid for a
/// year unless [`Self::valid_for`] or [`Self::for_days`] says otherwise.
#[derive(Clone, Debug)]
#[must_use = "`sign` makes the certificate"]
pub struct AllowPublish<'a> {
    terms: Terms<'a>,
    entity: Name,
    scope: Vec<Name>,
}

/// The certificate by which a reader may read or call a name, before it is signed. Valid for a year
/// unless [`Self::valid_for`] or [`Self::for_days`] says otherwise.
#[derive(Clone, Debug)]
#[must_use = "`sign` makes the certificate"]
pub struct AllowRead<'a> {
    terms: Terms<'a>,
    to: Grantee,
}

#[derive(Clone, Debug)]
struct Terms<'a> {
    owner: &'a SigningKey,
    card: &'a NameCard,
    lifetime: Duration,
}

/// Serial, start and end of a certificate that is issued now.
struct Dates {
    serial: u64,
    not_before: u64,
    not_after: u64,
}

impl Terms<'_> {
    /// Fails if the key is not the name's.
    fn dates(&self, what: &'static str) -> Result<Dates, CertError> {
        let (expected, got) = (self.card.owner_key(), self.owner.verify_key());
        if got != *expected {
            return Err(CertError::WrongKey { what, expected: expected.to_string(), got: got.to_string() });
        }
        let now = unix_seconds();
        let (not_before, not_after) = (now.saturating_sub(BACKDATED), now.saturating_add(self.lifetime.as_secs()));
        Ok(Dates { serial: unix_nanos(), not_before, not_after })
    }
}

impl AllowPublish<'_> {
    /// Sets how long the certificate is valid, from now.
    pub fn valid_for(mut self, lifetime: Duration) -> Self {
        self.terms.lifetime = lifetime;
        self
    }

    /// Sets how many days the certificate is valid, from now.
    pub fn for_days(self, days: u32) -> Self {
        self.valid_for(DAY * days)
    }

    /// Also lets this domain learn the name. Otherwise only the domain does in which it is
    /// advertised.
    pub fn in_domain(mut self, domain: Name) -> Self {
        self.scope.push(domain);
        self
    }

    /// Issues the certificate. [`Issued::to_pem`] is its text for a file `*.ad` of a keyring.
    ///
    /// # Errors
    ///
    /// Fails if the key is not that of the name's owner.
    pub fn sign(self) -> Result<Issued<AdCert>, CertError> {
        let Dates { serial, not_before, not_after } = self.terms.dates(AdCert::KIND)?;
        let (name, entity, scope) = (self.terms.card.name(), self.entity, self.scope);
        Ok(issue(self.terms.owner, &AdCert { name, entity, scope, serial, not_before, not_after })?.into())
    }
}

impl AllowRead<'_> {
    /// Sets how long the certificate is valid, from now.
    pub fn valid_for(mut self, lifetime: Duration) -> Self {
        self.terms.lifetime = lifetime;
        self
    }

    /// Sets how many days the certificate is valid, from now.
    pub fn for_days(self, days: u32) -> Self {
        self.valid_for(DAY * days)
    }

    /// Issues the certificate. [`Reading::to_pem`] is its text for a file `*.grant` of a keyring.
    ///
    /// # Errors
    ///
    /// Fails if the key is not that of the name's owner.
    pub fn sign(self) -> Result<Reading, CertError> {
        let Dates { serial, not_before, not_after } = self.terms.dates(ReadGrant::KIND)?;
        let (name, to) = (self.terms.card.name(), self.to);
        Ok(issue(self.terms.owner, &ReadGrant { name, to, serial, not_before, not_after })?.into())
    }
}

#[cfg(test)]
#[path = "../../tests/unit/cert/allow.rs"]
mod tests;
