//! Takes in an owner's revocation: what no longer holds goes at once, and all that have a part in the name are told. Nobody but
//! the owner can make one, so it does not matter who brings it.

use gdp::cert::{CertError, Revocation, Signed};
use gdp::control::{NameRole, Refusal, Response};
use gdp::name::NameProof;

use super::revocations::Origin;
use super::telling::Stake;
use super::{Now, Rib, refusal};

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
        let claims = signed.verify(&proof.verify_key().map_err(wrong)?, now.unix).map_err(refusal)?;
        if claims.name != name {
            return Err(refusal(CertError::WrongName { expected: name, got: claims.name }));
        }
        let (key, held) = (name.to_bytes(), self.revocations.claims(name.as_bytes()));
        claims.check_replaces(held).map_err(refusal)?;
        if held == Some(&claims) {
            return Ok(Response::Done);
        }
        let revoked = self.names.revoked(&key, &claims);
        self.revocations.put(key, signed.clone(), claims, origin);
        if !self.names.contains(&key) {
            self.revocations.leave(&key, self.limits.idle_revocations);
        }
        for (entity, role, switch) in revoked {
            let stake = Stake { name: key, entity, role };
            let is_told = self.names.get_at(&key, &entity, role, &switch).is_some_and(|r| r.bound);
            self.unregister(stake, switch);
            // Through the last of its switches.
            if is_told && self.names.get(&key, &entity, role).is_none() {
                self.telling.farewell(stake, switch);
            }
        }
        for role in NameRole::ALL {
            for (entity, _) in self.names.bound(&key, role) {
                self.telling.revocation_changed(Stake { name: key, entity, role });
            }
        }
        Ok(Response::Done)
    }
}
