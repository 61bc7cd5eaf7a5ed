//! The members that have joined, as the join service stores them.

use anyhow::Context as _;
use gdp_core::cert::{Membership, Revocation, Signed};
use gdp_core::identity::SigningKey;
use gdp_core::secret_file;
use gdp_directory::service::{JoinService, MAX_STORED};

use super::{Home, files};
use crate::cli::issuance_log::newest_revocation;

/// Returns the join service with the members that have joined.
pub(super) fn stored(home: &Home) -> anyhow::Result<JoinService> {
    let domain = home.card()?;
    let mut service = JoinService::new(SigningKey::load(&home.path("join.pem"))?, domain.name());
    let members = home.path("directory.members");
    if let Some(bytes) = secret_file::read_optional(&members, MAX_STORED)? {
        service.restore(&bytes).with_context(|| members.display().to_string())?;
    }
    service.restore_applications(home.applications()?);
    update(home, &mut service)?;
    Ok(service)
}

/// Applies what the domain's key has signed since: revocations and enrollments. Returns true if the
/// directory changes.
pub(super) fn update(home: &Home, service: &mut JoinService) -> anyhow::Result<bool> {
    let mut enrolled = false;
    for enrollment in home.signed_for_members(files::ENROLLMENTS, Signed::from_pem)? {
        enrolled |= service.enroll(enrollment);
    }
    for delegation in home.signed_for_members(files::RENEWALS, Signed::from_pem)? {
        service.delegate(delegation);
    }
    for membership in home.signed_for_members(files::MEMBERSHIPS, Membership::from_pem)? {
        enrolled |= service.readmit(membership);
    }
    // The last, because a revocation may end what the exchanged memberships replace.
    let revoked = revocation(home)?.is_some_and(|revocation| service.revoke(revocation));
    let decided = service.decide(home.decisions()?);
    Ok(revoked || enrolled || decided)
}

/// Returns the newest revocation of the domain, which lies beside its card.
fn revocation(home: &Home) -> anyhow::Result<Option<Revocation>> {
    Ok(newest_revocation(&home.card()?, &home.revocation_path())?.map(|(_, claims)| claims))
}
