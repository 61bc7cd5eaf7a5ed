//! The owner of many names, and the entities that publish or read them.

use std::ops::Range;
use std::time::SystemTime;

use anyhow::Result;
use gdp_core::cert::{AdCert, Advert, AdvertOp, Grantee, Issued, ReadGrant, Reading, RtCert, Signed, issue};
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::name::{NameProof, derive};
use gdp_proto::control::EntityRequest;
use gdp_wire::Name;

/// The largest number of names of one entity; a RIB accepts no more.
pub const NAMES_OF_ONE: usize = 16_384;

/// Lifetime of certificates and statements in seconds, longer than any run.
const LIFETIME: u32 = 24 * 3600;

/// Owns any number of names; each has a number.
pub struct Owner {
    key: SigningKey,
    now: u64,
}

impl Owner {
    pub fn new() -> Result<Self> {
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH)?.as_secs();
        Ok(Self { key: SigningKey::generate()?, now })
    }

    /// Returns the issue time of all certificates in Unix seconds.
    pub fn now(&self) -> u64 {
        self.now
    }

    pub fn key(&self) -> &SigningKey {
        &self.key
    }

    pub fn proof(&self, number: usize) -> NameProof {
        let mut digest = [0; 32];
        digest[..8].copy_from_slice(&(number as u64).to_be_bytes());
        NameProof { owner_key: self.key.public(), digest }
    }

    pub fn name(&self, number: usize) -> Name {
        let NameProof { owner_key, digest } = self.proof(number);
        derive(&owner_key, &digest)
    }

    /// Returns the statement that `entity` publishes a name at `switch`, for these domains.
    pub fn advertise(
        &self,
        number: usize,
        entity: &Identity,
        switch: Name,
        serial: u64,
        scope: Vec<Name>,
    ) -> Result<EntityRequest> {
        let (name, not_after) = (self.name(number), self.now + u64::from(LIFETIME));
        let (not_before, entity_name) = (self.now, entity.name());
        let cert = AdCert { name, entity: entity_name, scope, serial: 1, not_before, not_after };
        let ad_cert: Issued<AdCert> = issue(&self.key, &cert)?.into();
        let advert = advert(AdvertOp::Publish, name, entity, switch, serial)?;
        Ok(EntityRequest::Advertise { proof: self.proof(number), ad_cert, advert, everywhere: false })
    }

    /// Returns the statement that `entity` reads a name at `switch`.
    pub fn subscribe(&self, number: usize, entity: &Identity, switch: Name, serial: u64) -> Result<EntityRequest> {
        let (name, not_after) = (self.name(number), self.now + u64::from(LIFETIME));
        let to = Grantee::Entity(entity.name());
        let grant = ReadGrant { name, to, serial: 1, not_before: self.now, not_after };
        let grant: Reading = issue(&self.key, &grant)?.into();
        let advert = advert(AdvertOp::Subscribe, name, entity, switch, serial)?;
        Ok(EntityRequest::Subscribe { proof: self.proof(number), grant, advert, everywhere: false })
    }

    /// Returns the statement that `entity` no longer publishes or reads a name.
    pub fn withdraw(&self, number: usize, entity: &Identity, switch: Name, serial: u64) -> Result<EntityRequest> {
        let advert = advert(AdvertOp::Withdraw, self.name(number), entity, switch, serial)?;
        Ok(EntityRequest::Withdraw { advert })
    }

    /// Returns the statement that `switch` may carry the traffic of `entity`.
    pub fn attach(&self, entity: &Identity, switch: Name, resumes: bool) -> Result<EntityRequest> {
        let claims = RtCert { entity: entity.name(), switch, not_after: self.now + u64::from(LIFETIME) };
        Ok(EntityRequest::Attach { rt_cert: issue(entity.key(), &claims)?, resumes, lane: 0 })
    }
}

/// Splits the names from 0 on among as few entities as possible.
pub fn shares(names: usize) -> impl Iterator<Item = Range<usize>> {
    (0..names).step_by(NAMES_OF_ONE).map(move |first| first..names.min(first + NAMES_OF_ONE))
}

fn advert(op: AdvertOp, name: Name, entity: &Identity, switch: Name, serial: u64) -> Result<Signed<Advert>> {
    let (of, box_key) = (entity.name(), entity.box_public());
    Ok(issue(entity.key(), &Advert { op, name, entity: of, switch, serial, lifetime: LIFETIME, box_key })?)
}
