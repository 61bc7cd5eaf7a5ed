//! The members that have joined, as the join service stores them.

use anyhow::Context as _;
use gdp_core::cert::Revocation;
use gdp_core::identity::SigningKey;
use gdp_core::secret_file;
use gdp_directory::service::{Delegations, JoinService, MAX_STORED};

use super::Home;
use crate::cli::issuance_log::newest_revocation;

/// Returns the join service with the members that have joined.
pub(super) fn stored(home: &Home) -> anyhow::Result<JoinService> {
    let domain = home.card()?;
    let delegations =
        Delegations { directory: home.signed("directory.delegation")?, join: home.signed("join.delegation")? };
    let mut service = JoinService::new(SigningKey::load(&home.path("join.pem"))?, domain.name(), delegations);
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
    let revoked = revocation(home)?.is_some_and(|revocation| service.revoke(revocation));
    let mut enrolled = false;
    for enrollment in home.signed_enrollments()? {
        enrolled |= service.enroll(enrollment);
    }
    let decided = service.decide(home.decisions()?);
    Ok(revoked || enrolled || decided)
}

/// Returns the newest revocation of the domain, which lies beside its card.
fn revocation(home: &Home) -> anyhow::Result<Option<Revocation>> {
    Ok(newest_revocation(&home.card()?, &home.revocation_path())?.map(|(_, claims)| claims))
}
