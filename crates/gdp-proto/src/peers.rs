//! Counterparts of an entity under one name, as verified from the updates of its RIB. Updates go
//! in; counterparts that join and leave come out. It performs no I/O; `gdp` feeds one
//! [`Counterparts`] for each name and role it has stated.
//!
//! The RIB is not trusted. Every record is verified again from the owner's key on, under the newest
//! received revocation, whatever its sender. An older revocation, as a RIB may repeat, restores
//! nothing. Key boxes are passed on unverified: the opener knows the writer's key from here. A
//! lying RIB can thus withhold a counterpart, a box or a revocation, but cannot make anybody a
//! counterpart.

use std::collections::{BTreeMap, BTreeSet};

use crate::control::{NameRole, Peers, PeersExtent, Record};
use gdp_core::cert::{CertError, Membership, Revocation, Signed};
use gdp_core::crypto::PUBLIC_KEY_LEN;
use gdp_core::identity::VerifyKey;
use gdp_core::keys::KeyBox;
use gdp_core::name::{Name, NameProof};

/// Maximum number of concurrent counterparts for one name; a RIB has no more.
pub const MAX_COUNTERPARTS: usize = 8192;

/// Counterpart whose right to the name is verified.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Counterpart {
    pub entity: Name,
    /// A switch of its attachment.
    pub switch: Name,
    /// Public key of its signatures.
    pub key: VerifyKey,
    /// Public key for wrapping keys to it and for key agreement: P-256, SEC1 compressed.
    pub box_key: [u8; PUBLIC_KEY_LEN],
    /// End of its right in Unix seconds.
    pub not_after: u64,
    serials: Vec<(&'static str, u64)>,
    /// Membership behind its right, if that was granted to a role in a domain.
    member: Option<Box<Membership>>,
}

impl Counterpart {
    /// Creates a counterpart as if a certificate with this serial had been verified, for tests.
    #[doc(hidden)]
    pub fn for_test(entity: Name, switch: Name, key: VerifyKey, not_after: u64, serial: u64) -> Self {
        Self {
            entity,
            switch,
            key,
            box_key: [0; PUBLIC_KEY_LEN],
            not_after,
            serials: vec![("AdCert", serial)],
            member: None,
        }
    }

    /// Returns whether its right is still valid under this revocation of the name.
    pub fn holds(&self, revocation: &Revocation) -> bool {
        self.serials.iter().all(|(what, serial)| revocation.check(what, *serial).is_ok())
    }
}

/// Change for the entity.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PeerEvent {
    /// The counterpart is new, or presents another right or key than before.
    Joined(Counterpart),
    /// The counterpart withdrew, detached, or its right ended or was revoked.
    Left(Name),
    /// The counterpart's domain has revoked the membership behind its right.
    Expelled(Name),
    /// The owner has revoked certificates, possibly the entity's own.
    Revoked(Revocation),
    /// The RIB does not know this revocation, for example after losing its state. The entity must
    /// send it to the RIB, which then enforces it again.
    RibIsBehind(Signed<Revocation>),
    /// Key box from a counterpart to the entity, which verifies it when opening it.
    KeyBox(Signed<KeyBox>),
    /// The RIB sent something that does not verify.
    Refused(CertError),
}

/// Error: the update does not follow the state held. The RIB must send the full list.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("told generation {got} (run {run:#x}), which does not follow what is held; tell the whole")]
pub struct OutOfStep {
    pub run: u64,
    pub got: u64,
}

/// Counterparts of an entity for one name.
#[derive(Debug)]
pub struct Counterparts {
    name: Name,
    proof: NameProof,
    role: NameRole,
    revocation: Option<(Signed<Revocation>, Revocation)>,
    /// Revocations by related domains, by domain.
    domains: BTreeMap<Name, Revocation>,
    known: BTreeMap<Name, Counterpart>,
    /// Run and generation of the last update.
    known_generation: Option<(u64, u64)>,
    /// Full list in progress: the number of the next part, and the entities named so far.
    whole: Option<(u32, BTreeSet<Name>)>,
}

impl Counterparts {
    /// Creates an empty set. `role` is the entity's own role for the name in `proof`.
    pub fn new(proof: NameProof, role: NameRole) -> Result<Self, CertError> {
        let (name, domains, known) = (proof.name()?, BTreeMap::new(), BTreeMap::new());
        Ok(Self { name, proof, role, revocation: None, domains, known, known_generation: None, whole: None })
    }

    pub fn known(&self) -> impl Iterator<Item = &Counterpart> {
        self.known.values()
    }

    pub fn get(&self, entity: &Name) -> Option<&Counterpart> {
        self.known.get(entity)
    }

    /// Restores a revocation that was verified before, for example by an earlier process.
    pub fn recall(&mut self, revocation: (Signed<Revocation>, Revocation)) {
        self.revocation = Some(revocation);
    }

    /// Returns the newest received revocation with its owner's signature.
    pub fn signed_revocation(&self) -> Option<&Signed<Revocation>> {
        self.revocation.as_ref().map(|(signed, _)| signed)
    }

    /// Returns the newest received revocation.
    pub fn revocation(&self) -> Option<&Revocation> {
        self.revocation.as_ref().map(|(_, claims)| claims)
    }

    /// Returns the proof of the name.
    pub fn proof(&self) -> &NameProof {
        &self.proof
    }

    /// Processes an update of the RIB, an answer or a push, at `now` (Unix seconds).
    pub fn take(&mut self, now: u64, peers: &Peers) -> Result<Vec<PeerEvent>, OutOfStep> {
        self.check_order(peers).ok_or(OutOfStep { run: peers.run, got: peers.generation })?;
        self.known_generation = Some((peers.run, peers.generation));
        let begins = matches!(peers.extent, PeersExtent::Whole { part: 0, .. });
        if begins {
            self.whole = Some((0, BTreeSet::new()));
        }
        let mut events = Vec::new();
        match (&peers.revocation, &self.revocation) {
            (Some(signed), _) => self.revoke(signed, &mut events),
            (None, Some((held, _))) if begins => events.push(PeerEvent::RibIsBehind(held.clone())),
            (None, _) => {}
        }
        for record in &peers.records {
            match self.believe(now, record) {
                Ok(counterpart) => {
                    if let Some((_, named)) = &mut self.whole {
                        named.insert(counterpart.entity);
                    }
                    if self.known.get(&counterpart.entity) != Some(&counterpart) {
                        self.known.insert(counterpart.entity, counterpart.clone());
                        events.push(PeerEvent::Joined(counterpart));
                    }
                }
                Err(error) => events.push(PeerEvent::Refused(error)),
            }
        }
        self.leave(&peers.departed, &mut events);
        match (peers.extent, &mut self.whole) {
            (PeersExtent::Whole { last: true, .. }, whole) => {
                let named = whole.take().map_or_else(BTreeSet::new, |(_, named)| named);
                let unnamed = self.known.keys().filter(|entity| !peers.settling && !named.contains(*entity));
                let departed: Vec<Name> = unnamed.copied().collect();
                self.leave(&departed, &mut events);
            }
            (PeersExtent::Whole { last: false, .. }, Some((next, _))) => *next += 1,
            _ => {}
        }
        events.extend(peers.boxes.iter().cloned().map(PeerEvent::KeyBox));
        Ok(events)
    }

    /// Applies a domain's verified revocation. Removes counterparts whose right rests on it, and
    /// refuses such ones from now on.
    pub fn domain_revoked(&mut self, claims: &Revocation) -> Vec<PeerEvent> {
        self.domains.insert(claims.name, claims.clone());
        let is_over = |counterpart: &Counterpart| {
            let of_domain = |member: &&Membership| member.domain.name().is_ok_and(|domain| domain == claims.name);
            counterpart.member.as_deref().filter(of_domain).is_some_and(|it| it.check_revoked(Some(claims)).is_err())
        };
        let departed: Vec<Name> = self.known().filter(|c| is_over(c)).map(|c| c.entity).collect();
        departed.iter().for_each(|entity| drop(self.known.remove(entity)));
        departed.into_iter().map(PeerEvent::Expelled).collect()
    }

    /// Removes counterparts whose right has ended.
    pub fn expire(&mut self, now: u64) -> Vec<PeerEvent> {
        let mut events = Vec::new();
        let departed: Vec<Name> = self.known().filter(|c| c.not_after < now).map(|c| c.entity).collect();
        self.leave(&departed, &mut events);
        events
    }

    /// Verifies a record and returns its counterpart.
    pub fn believe(&self, now: u64, record: &Record) -> Result<Counterpart, CertError> {
        if record.name != self.name {
            return Err(CertError::WrongName { expected: self.name, got: record.name });
        }
        let verified = record.verify(self.revocation(), now)?;
        record.credential.check_member(|domain| self.domains.get(domain))?;
        let role = self.role.counterpart();
        if verified.advert.op != role.op() {
            return Err(CertError::Malformed(format!("a statement to {} is not of a {role}", verified.advert.op)));
        }
        if self.known.len() >= MAX_COUNTERPARTS && !self.known.contains_key(&verified.entity) {
            return Err(CertError::Malformed(format!("more than {MAX_COUNTERPARTS} {role}s of one name")));
        }
        Ok(Counterpart {
            entity: verified.entity,
            switch: record.switch,
            key: record.entity.verify_key()?,
            box_key: verified.advert.box_key,
            not_after: verified.not_after,
            serials: record.credential.serials()?,
            member: record.credential.member().cloned().map(Box::new),
        })
    }

    fn check_order(&self, peers: &Peers) -> Option<()> {
        let newer = self.known_generation.is_none_or(|(run, held)| run != peers.run || peers.generation > held);
        let same_run = self.known_generation.is_some_and(|(run, _)| run == peers.run);
        let in_order = match peers.extent {
            PeersExtent::Whole { part: 0, .. } => true,
            PeersExtent::Whole { part, .. } => same_run && self.whole.as_ref().is_some_and(|(next, _)| *next == part),
            PeersExtent::After(held) => self.known_generation == Some((peers.run, held)) && self.whole.is_none(),
        };
        (newer && in_order).then_some(())
    }

    fn revoke(&mut self, signed: &Signed<Revocation>, events: &mut Vec<PeerEvent>) {
        let claims = match signed.verify_revocation(&self.proof) {
            Ok(claims) => claims,
            Err(error) => return events.push(PeerEvent::Refused(error)),
        };
        if let Some((newest, held)) = &self.revocation {
            if *held == claims {
                return;
            }
            if let Err(error) = claims.check_replaces(Some(held)) {
                events.push(PeerEvent::Refused(error));
                return events.push(PeerEvent::RibIsBehind(newest.clone()));
            }
        }
        let departed: Vec<Name> = self.known().filter(|c| !c.holds(&claims)).map(|c| c.entity).collect();
        self.revocation = Some((signed.clone(), claims.clone()));
        events.push(PeerEvent::Revoked(claims));
        self.leave(&departed, events);
    }

    fn leave(&mut self, departed: &[Name], events: &mut Vec<PeerEvent>) {
        events.extend(
            departed.iter().filter(|entity| self.known.remove(*entity).is_some()).copied().map(PeerEvent::Left),
        );
    }
}

#[cfg(test)]
#[path = "../tests/unit/peers.rs"]
mod tests;
