//! Processes an owner's revocation. Invalid registrations end at once, and all entities registered
//! for the name are notified. Only the owner can sign a revocation, so any sender may deliver it.

use gdp_core::cert::{CertError, Revocation, Signed};
use gdp_core::name::NameProof;
use gdp_core::revocations::{Origin, SignedRevocation};
use gdp_proto::control::{NameRole, Refusal, Response};
use gdp_wire::Name;

use super::Rib;
use crate::rib::model::{Now, RegistrationKey, refusal};

impl Rib {
    pub(super) fn revoke(
        &mut self,
        now: Now,
        origin: Origin,
        proof: &NameProof,
        signed: &Signed<Revocation>,
    ) -> Result<Response, Refusal> {
        let wrong = |error| refusal(CertError::Crypto(error));
        let name = proof.name().map_err(wrong)?;
        let claims = signed.verify_revocation(proof).map_err(refusal)?;
        let (key, held) = (name.to_bytes(), self.revocations.claims(name.as_bytes()));
        claims.check_replaces(held).map_err(refusal)?;
        if held == Some(&claims) {
            return Ok(Response::Done);
        }
        let revoked = self.names.revoked(&key, &claims);
        let kept = SignedRevocation { proof: *proof, revocation: signed.clone(), origin: Some(origin) };
        self.revocations.put(key, kept, claims, self.names.contains(&key), &self.limits);
        for (entity, role, switch) in revoked {
            self.end_revoked(now, RegistrationKey { name: key, entity, role }, switch);
        }
        for role in NameRole::ALL {
            for (entity, _) in self.names.bound(&key, role) {
                self.peer_updates.revocation_changed(&self.names, RegistrationKey { name: key, entity, role });
            }
        }
        Ok(Response::Done)
    }

    /// Ends a revoked registration and notifies its entity.
    fn end_revoked(&mut self, now: Now, registration_key: RegistrationKey, switch: Name) {
        let RegistrationKey { name, entity, role } = registration_key;
        let is_told = self.names.get_at(&name, &entity, role, &switch).is_some_and(|r| r.bound && r.is_here());
        self.end(now, registration_key, switch);
        // The entity is notified through the last of its switches.
        if is_told && self.names.get(&name, &entity, role).is_none() {
            self.peer_updates.farewell(registration_key, switch);
        }
    }

    /// Applies a domain's verified revocation. Only current holders of a role may still read names
    /// granted to that role.
    pub fn domain_revoked(&mut self, now: Now, claims: &Revocation) {
        self.tick(now);
        self.domains.insert(claims.name, claims.clone());
        for (registration_key, switch) in self.names.expelled(claims) {
            self.end_revoked(now, registration_key, switch);
        }
    }

    /// Applies a revocation announced by the RIB of the neighbouring domain `next`.
    pub fn revoke_from(&mut self, now: Now, next: Name, told: &SignedRevocation) -> Result<(), Refusal> {
        self.tick(now);
        self.revoke(now, Origin { through: next, by_tool: false }, &told.proof, &told.revocation).map(drop)
    }

    /// Restores the verified revocations of an earlier RIB, in the order of
    /// [`Self::signed_revocations`].
    pub fn recall(&mut self, kept: Vec<(SignedRevocation, Revocation)>) {
        for (kept, claims) in kept.into_iter().rev() {
            let key = claims.name.to_bytes();
            if claims.check_replaces(self.revocations.claims(&key)).is_ok() {
                self.revocations.put(key, kept, claims, false, &self.limits);
            }
        }
    }

    /// Returns a counter that increases with each stored revocation.
    pub fn revocations_taken(&self) -> u64 {
        self.revocations.changes()
    }

    /// Returns all revocations for a successor of this RIB, the most important first.
    pub fn signed_revocations(&self) -> Vec<SignedRevocation> {
        self.revocations.all()
    }
}
