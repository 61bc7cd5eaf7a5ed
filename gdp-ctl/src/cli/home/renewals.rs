//! Memberships that renew themselves: what the domain's key signs so that the join service may
//! renew them, and the renewal of this server's own.

use std::fs;

use anyhow::Context as _;
use gdp_core::cert::domain::roles;
use gdp_core::cert::{MemberCert, Membership, RenewalDelegation, Signed, issue};
use gdp_core::identity::{SigningKey, VerifyKey};
use gdp_core::secret_file;
use gdp_util::unix_time::{unix_nanos, unix_seconds};
use gdp_wire::Name;

use super::{DAY, Home};
use crate::cli::domain::{Authority, Issue, To};
use crate::cli::issuing::validity;

/// Seconds for which the domain lets a membership be renewed, if nothing shorter is wanted.
pub const RENEWABLE: u64 = 10 * 365 * DAY;

/// An entity of this server.
#[derive(Clone, Copy)]
pub struct Own {
    /// The first part of its files' names.
    pub label: &'static str,
    pub role: &'static str,
}

pub const SWITCH: Own = Own { label: "switch", role: roles::RIB };
pub const JOIN: Own = Own { label: "join", role: "join" };
pub const OWN: [Own; 2] = [SWITCH, JOIN];

/// Whether a role is of this server's own entities or of machines that ask, so of no member.
pub fn is_of_server(role: &str) -> bool {
    role == roles::APPLICANT || OWN.iter().any(|own| own.role == role)
}

/// Signs that the join service with this key may renew the membership with this serial until
/// `not_after`.
pub fn delegate_renewal(
    authority: &Authority,
    key: VerifyKey,
    member: u64,
    lifetime: u64,
    not_after: u64,
) -> anyhow::Result<Signed<RenewalDelegation>> {
    let (domain, serial, (not_before, _)) = (authority.identity.name(), member, validity(0));
    let claims = RenewalDelegation { domain, member, key, lifetime, serial, not_before, not_after };
    Ok(issue(authority.identity.key(), &claims)?)
}

impl Home {
    /// Issues the membership of an entity of this server.
    pub(super) fn admit(&self, entity: Name, own: Own, lifetime: u64) -> anyhow::Result<()> {
        let authority = self.authority()?;
        let (not_before, not_after) = validity(lifetime);
        let (domain, role, serial, ends) =
            (authority.identity.name(), own.role.to_owned(), authority.serial, validity(RENEWABLE).1);
        let claims = MemberCert { domain, entity, role: role.clone(), serial, not_before, not_after };
        let membership = Membership::issue(&authority.identity, &claims)?;
        let join_service = SigningKey::load(&self.path("join.pem"))?.verify_key();
        let renewal = delegate_renewal(&authority, join_service, serial, lifetime, ends)?;
        let file = Some(self.member_file(own));
        let (to, label) = (To::Member { entity, role }, Some(own.label.to_owned()));
        authority.remember(Issue { serial, to, label, not_before, not_after, ends, file })?;
        secret_file::replace(&self.renewal_file(own), renewal.to_pem().as_bytes())?;
        Ok(secret_file::replace(&self.member_file(own), membership.to_pem().as_bytes())?)
    }

    /// Whether an entity of this server is a member, after a renewal that was due.
    pub(super) fn is_admitted(&self, own: Own) -> anyhow::Result<bool> {
        if !self.member_file(own).exists() || !self.renewal_file(own).exists() {
            return Ok(false);
        }
        let renewed = self.renew_own(own);
        let (membership, ledger) = (self.membership(own)?, self.ledger()?);
        let domain = membership.domain.name()?;
        Ok(renewed.is_ok() && membership.verify(domain, ledger.revocation.as_ref(), unix_seconds()).is_ok())
    }

    /// Renews the memberships of this server's entities of which half has passed. Logs errors,
    /// because the memberships may still hold for long.
    pub(super) fn renew_all_own(&self) {
        for own in OWN {
            match self.renew_own(own) {
                Ok(true) => tracing::info!("renewed the membership of the {}", own.label),
                Ok(false) => {}
                Err(error) => tracing::error!("the membership of the {} is not renewed: {error:#}", own.label),
            }
        }
    }

    /// Renews the membership of an entity of this server if half of it has passed. Returns whether
    /// it did.
    fn renew_own(&self, own: Own) -> anyhow::Result<bool> {
        let membership = self.membership(own)?;
        if !membership.is_half_over(unix_seconds())? {
            return Ok(false);
        }
        let path = self.renewal_file(own);
        let delegation = fs::read_to_string(&path).with_context(|| path.display().to_string())?;
        let delegation = Signed::from_pem(&delegation).with_context(|| path.display().to_string())?;
        let key = SigningKey::load(&self.path("join.pem"))?;
        let renewed = membership.renew(&key, &delegation, unix_nanos())?;
        secret_file::replace(&self.member_file(own), renewed.to_pem().as_bytes())?;
        Ok(true)
    }

    pub(super) fn membership(&self, own: Own) -> anyhow::Result<Membership> {
        let path = self.member_file(own);
        let text = fs::read_to_string(&path).with_context(|| format!("{}: run `gdp-ctl up`", path.display()))?;
        Membership::from_pem(&text).with_context(|| path.display().to_string())
    }

    pub(super) fn member_file(&self, own: Own) -> std::path::PathBuf {
        self.path(&format!("{}.member", own.label))
    }

    fn renewal_file(&self, own: Own) -> std::path::PathBuf {
        self.path(&format!("{}.renewal", own.label))
    }
}
