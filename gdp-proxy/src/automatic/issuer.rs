//! Makes the cards of exposed names, and issues their certificates with the key of the owner.
//!
//! A name follows from what it is of, its type and what else the configuration says of it, so it is
//! the same whenever the proxy runs; and from a secret that follows from the owner's key, so nobody
//! guesses it. Certificates hold for [`LIFETIME`] and are issued anew when half of it is over: who
//! is taken off the readers loses the right by then.

use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, CertError, Grantee, Issued, Mode, ReadGrant, issue};
use gdp_core::crypto::{Backend, CryptoError};
use gdp_core::identity::SigningKey;
use gdp_core::name::Metadata;
use gdp_wire::Name;

use super::choice::Exposed;
use crate::config::{ExposeConfig, Thing};
use crate::ros2::TypeName;

/// Seconds.
pub const LIFETIME: u64 = 24 * 3600;

/// Seconds by which it begins earlier: clocks differ.
const BACKDATED: u64 = 300;

/// What the secret is derived for.
const CONTEXT: &[u8] = b"gdp-proxy/expose/1";

pub struct Issuer {
    owner: SigningKey,
    /// This proxy.
    entity: Name,
}

/// The certificates of a name.
#[derive(Clone)]
pub struct IssuedCredentials {
    pub cert: Issued<AdCert>,
    pub grants: Vec<Issued<ReadGrant>>,
    /// Unix seconds.
    pub issued: u64,
}

/// A name could not be made.
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

    /// The card of something.
    pub fn card(&self, thing: Thing, kind: Option<&TypeName>, exposed: &Exposed) -> Result<NameCard, IssueError> {
        card_of(&self.owner, thing, kind, exposed)
    }

    /// For this proxy to publish or serve the name, and for the readers to read or call it. `now`:
    /// nanoseconds since 1970.
    pub fn issue(&self, name: Name, config: &ExposeConfig, now: u64) -> Result<IssuedCredentials, IssueError> {
        let (serial, issued) = (now, now / 1_000_000_000);
        let (not_before, not_after) = (issued.saturating_sub(BACKDATED), issued.saturating_add(LIFETIME));
        let (entity, mode, scope) = (self.entity, Mode::Multicast, config.scope.clone());
        let cert = issue(&self.owner, &AdCert { name, entity, mode, scope, serial, not_before, not_after })?.into();
        let grant =
            |to: &Grantee| issue(&self.owner, &ReadGrant { name, to: to.clone(), serial, not_before, not_after });
        let grants = config.readers.iter().map(|reader| Ok(grant(&reader.0)?.into()));
        Ok(IssuedCredentials { cert, grants: grants.collect::<Result<_, CertError>>()?, issued })
    }
}

/// The card of something that this owner has.
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
    let secret = Backend::default().hkdf_sha256(&[], &owner.pkcs8_der(), &[CONTEXT, said.as_bytes()])?;
    metadata.insert("nonce".into(), hex::encode(&secret[..16]));
    Ok(NameCard::new(owner.verify_key(), metadata)?)
}

impl IssuedCredentials {
    /// Half of their time is over, or the clock was set back. `now`: nanoseconds since 1970.
    pub fn are_old(&self, now: u64) -> bool {
        let now = now / 1_000_000_000;
        !(self.issued..self.issued.saturating_add(LIFETIME / 2)).contains(&now)
    }
}

#[cfg(test)]
#[path = "../../tests/unit/automatic/issuer.rs"]
mod tests;
