//! Owners of names.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::Result;
use gdp::unstable::{Node, PublishOptions, Publisher, SubscribeOptions, Subscription};
use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Grantee, Issued, ReadGrant, Reading, Revocation, Signed, issue};
use gdp_core::identity::SigningKey;
use gdp_wire::Name;

/// The owner of one name, which issues its certificates.
pub struct Owner {
    pub key: SigningKey,
    pub card: NameCard,
    numbers: AtomicU64,
}

impl Owner {
    pub fn new(topic: &str) -> Result<Self> {
        let key = SigningKey::generate()?;
        let card = NameCard::create(key.verify_key(), "topic", topic, "T", None)?;
        Ok(Self { key, card, numbers: AtomicU64::new(1) })
    }

    /// Returns an owner with the same card but another key.
    pub fn impostor(&self) -> Result<Self> {
        Ok(Self { key: SigningKey::generate()?, card: self.card.clone(), numbers: AtomicU64::new(1) })
    }

    pub fn name(&self) -> Name {
        self.card.name()
    }

    pub fn ad_cert(&self, entity: Name) -> Result<Issued<AdCert>> {
        let (name, (serial, not_after)) = (self.name(), now());
        let (scope, not_before) = (vec![], 0);
        Ok(issue(&self.key, &AdCert { name, entity, scope, serial, not_before, not_after })?.into())
    }

    pub fn grant(&self, entity: Name) -> Result<Reading> {
        let (name, (serial, not_after)) = (self.name(), now());
        let (to, not_before) = (Grantee::Entity(entity), 0);
        Ok(issue(&self.key, &ReadGrant { name, to, serial, not_before, not_after })?.into())
    }

    /// Issues a revocation of these serials, under the next number.
    pub fn revocation(&self, mut revoked: Vec<u64>) -> Result<Signed<Revocation>> {
        revoked.sort_unstable();
        let number = self.numbers.fetch_add(1, Ordering::Relaxed);
        Ok(issue(&self.key, &Revocation { name: self.name(), number, floor: 0, revoked, signer: None })?)
    }

    pub async fn publish(&self, node: &Node, options: PublishOptions) -> Result<Publisher> {
        let ad_cert = self.ad_cert(node.name())?;
        Ok(node.publish(self.card.proof(), ad_cert, options).await?)
    }

    pub async fn subscribe(&self, node: &Node, options: SubscribeOptions) -> Result<Subscription> {
        let grant = self.grant(node.name())?;
        Ok(node.subscribe(self.card.proof(), grant, options).await?)
    }
}

/// Returns a serial, and an expiry in an hour.
fn now() -> (u64, u64) {
    let time = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    (time.as_nanos() as u64, time.as_secs() + 3600)
}

/// Returns the serial of the first certificate in the list.
pub fn serial(serials: Result<Vec<(&'static str, u64)>, gdp_core::cert::CertError>) -> Result<u64> {
    Ok(serials?[0].1)
}
