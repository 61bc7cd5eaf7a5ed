//! Makes the cards of exposed names, and issues their certificates with the key of the owner.
//!
//! A name depends on the entity, its type and its configured metadata, so it is the same after each
//! start. It also depends on a secret derived from the owner's key, so nobody can guess it.
//! Certificates are valid for [`LIFETIME`] and are renewed after half of it. An entity that is
//! removed from the readers loses the right within [`LIFETIME`].

use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, BACKDATED, CertError, Grantee, Issued, ReadGrant, issue};
use gdp_core::crypto::{self, CryptoError};
use gdp_core::identity::SigningKey;
use gdp_core::name::Metadata;
use gdp_ros::catalog::MAX_GRANTS;
use gdp_wire::Name;

use super::choice::Exposed;
use crate::config::{ExposeConfig, MemberReader, Thing};
use crate::ros2::{TopicName, TypeName};

/// Validity of a certificate in seconds.
pub const LIFETIME: u64 = 24 * 3600;

/// HKDF context of the secret in a name.
const CONTEXT: &[u8] = b"gdp-proxy/expose/1";

pub struct Issuer {
    owner: SigningKey,
    /// The proxy's own name.
    entity: Name,
}

/// The certificates of one name.
#[derive(Clone)]
pub struct IssuedCredentials {
    pub cert: Issued<AdCert>,
    pub grants: Vec<Issued<ReadGrant>>,
    /// Time of issue in Unix seconds.
    pub issued: u64,
}

/// Errors while a name or its certificates are made.
#[derive(Debug, thiserror::Error)]
pub enum IssueError {
    #[error(transparent)]
    Card(#[from] gdp_core::card::CardError),
    #[error(transparent)]
    Cert(#[from] CertError),
    #[error(transparent)]
    Crypto(#[from] CryptoError),
}

impl Issuer {
    pub fn new(owner: SigningKey, entity: Name) -> Self {
        Self { owner, entity }
    }

    /// Returns the name card of an exposed entity.
    pub fn card(&self, thing: Thing, kind: Option<&TypeName>, exposed: &Exposed) -> Result<NameCard, IssueError> {
        card_of(&self.owner, thing, kind, exposed)
    }

    /// Issues the certificate to publish or serve the name for this proxy, and the grants for the
    /// readers. `called` is what it is in the catalog, `None` for the catalog itself, for which the
    /// join service issues the members' grants. `now` is in Unix nanoseconds.
    pub fn issue(
        &self,
        name: Name,
        called: Option<(Thing, &TopicName)>,
        config: &ExposeConfig,
        now: u64,
    ) -> Result<IssuedCredentials, IssueError> {
        let (serial, issued) = (now, now / 1_000_000_000);
        let (not_before, not_after) = (issued.saturating_sub(BACKDATED), issued.saturating_add(LIFETIME));
        let (entity, scope) = (self.entity, config.scope.clone());
        let cert = issue(&self.owner, &AdCert { name, entity, scope, serial, not_before, not_after })?.into();
        let grant =
            |to: &Grantee| issue(&self.owner, &ReadGrant { name, to: to.clone(), serial, not_before, not_after });
        let may_read = |reader: &&MemberReader| called.is_some_and(|(thing, name)| reader.names.covers(thing, name));
        let members = config.shared.readers.iter().filter(may_read).map(|reader| Grantee::Entity(reader.entity));
        let readers = config.readers.iter().map(|reader| reader.0.clone()).chain(members);
        if readers.clone().count() > MAX_GRANTS {
            tracing::warn!(%name, "more than {MAX_GRANTS} may read it, and the others get no grant; give them a role");
        }
        let readers = readers.take(MAX_GRANTS);
        let grants = readers.map(|reader| Ok(grant(&reader)?.into()));
        Ok(IssuedCredentials { cert, grants: grants.collect::<Result<_, CertError>>()?, issued })
    }
}

/// Returns the name card of an exposed entity of this owner.
pub fn card_of(
    owner: &SigningKey,
    thing: Thing,
    kind: Option<&TypeName>,
    exposed: &Exposed,
) -> Result<NameCard, IssueError> {
    let kind = kind.map_or("", TypeName::as_str);
    let said = [("kind", thing.as_str()), ("topic", exposed.name.as_str()), ("type", kind)];
    let mut metadata: Metadata = exposed.rule_options.meta.clone();
    metadata.extend(said.map(|(key, value)| (key.to_owned(), value.to_owned())));
    let said = gdp_core::name::canonical_json(&metadata);
    let secret = crypto::hkdf_sha256(&[], &owner.pkcs8_der(), &[CONTEXT, said.as_bytes()])?;
    metadata.insert("nonce".into(), hex::encode(&secret[..16]));
    Ok(NameCard::new(owner.verify_key(), metadata)?)
}

impl IssuedCredentials {
    /// Whether half of the validity has passed, or the clock was set back. `now` is in Unix
    /// nanoseconds.
    pub fn are_old(&self, now: u64) -> bool {
        let now = now / 1_000_000_000;
        !(self.issued..self.issued.saturating_add(LIFETIME / 2)).contains(&now)
    }
}

#[cfg(test)]
#[path = "../../tests/unit/automatic/issuer.rs"]
mod tests;
