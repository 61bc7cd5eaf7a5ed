//! The newest Enrollment of each label, in one file. The join service takes what is signed for its
//! members from there.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::Context as _;
use gdp_core::cert::{Enrollment, Signed};
use gdp_core::secret_file;
use gdp_util::unix_time::unix_seconds;

use super::{Home, members};
use crate::cli::domain::{Authority, Issue, To};

/// Name of the file.
pub const FILE: &str = "enrollments";

/// Maximum size of the file, in bytes.
const MAX_FILE: usize = 8 << 20;

impl Home {
    /// Returns the enrollments by label, as text. They may be of members that are revoked.
    fn enrollments(&self) -> anyhow::Result<BTreeMap<String, String>> {
        let path = self.path(FILE);
        match secret_file::read_optional(&path, MAX_FILE)? {
            Some(bytes) => serde_json::from_slice(&bytes).with_context(|| format!("{}: damaged", path.display())),
            None => Ok(BTreeMap::new()),
        }
    }

    pub(super) fn signed_enrollments(&self) -> anyhow::Result<Vec<Signed<Enrollment>>> {
        let parse = |text: &String| Ok(Signed::from_pem(text)?);
        self.enrollments()?.values().map(parse).collect()
    }

    pub(super) fn keep_enrollment(&self, label: &str, signed: &Signed<Enrollment>) -> anyhow::Result<()> {
        let mut enrollments = self.enrollments()?;
        enrollments.insert(label.into(), signed.to_pem());
        Ok(secret_file::replace(&self.path(FILE), &serde_json::to_vec_pretty(&enrollments)?)?)
    }

    /// Returns the enrollments of members, and of those whose invitation can still be used.
    pub(super) fn enrolled(&self) -> anyhow::Result<BTreeMap<String, Enrollment>> {
        let authority = self.authority()?;
        let open = self.open_serials(&authority)?;
        let mut enrolled = BTreeMap::new();
        for signed in self.signed_enrollments()? {
            let claims = signed.verify_signature(&authority.identity.key().verify_key())?;
            if open.contains(&claims.member) {
                enrolled.insert(claims.label.clone(), claims);
            }
        }
        Ok(enrolled)
    }

    /// Returns the serials of memberships, and of invitations that can still be used.
    pub(super) fn open_serials(&self, authority: &Authority) -> anyhow::Result<BTreeSet<u64>> {
        let now = unix_seconds();
        let service = members::stored(self)?;
        let joined: BTreeSet<u64> = service.rows(now).iter().map(|row| row.enrollment.member).collect();
        let holds = |issue: &&Issue| {
            let is_used = joined.contains(&issue.serial) || matches!(issue.to, To::Member { .. });
            let is_open = if is_used { issue.ends > now } else { issue.not_after > now };
            is_open && !issue.is_revoked(authority.revocation.as_ref()) && !service.has_left(issue.serial)
        };
        Ok(authority.issued.iter().filter(holds).map(|issue| issue.serial).collect())
    }
}
