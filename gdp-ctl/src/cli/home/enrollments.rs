//! What the domain's key has signed for its members, in a file for each kind of certificate, by
//! label. The join service takes it from there.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::Context as _;
use gdp_core::cert::{CertError, Enrollment, Signed};
use gdp_core::secret_file;
use gdp_util::unix_time::unix_seconds;

use super::{Home, files, members};
use crate::cli::domain::{DomainLedger, Issue, To};

/// Maximum size of the file, in bytes.
const MAX_FILE: usize = 8 << 20;

impl Home {
    /// Returns the certificates of a file by label, as text. They may be of members that are
    /// revoked.
    fn by_label(&self, file: &str) -> anyhow::Result<BTreeMap<String, String>> {
        let path = self.path(file);
        match secret_file::read_optional(&path, MAX_FILE)? {
            Some(bytes) => serde_json::from_slice(&bytes).with_context(|| format!("{}: damaged", path.display())),
            None => Ok(BTreeMap::new()),
        }
    }

    /// Returns the certificates of a file.
    pub(super) fn signed_for_members<T>(
        &self,
        file: &str,
        parse: impl Fn(&str) -> Result<T, CertError>,
    ) -> anyhow::Result<Vec<T>> {
        self.by_label(file)?.values().map(|text| parse(text).with_context(|| file.to_owned())).collect()
    }

    /// Stores what was signed for members, by label.
    pub(super) fn keep_signed(
        &self,
        file: &str,
        signed: impl IntoIterator<Item = (String, String)>,
    ) -> anyhow::Result<()> {
        let mut known = self.by_label(file)?;
        known.extend(signed);
        Ok(secret_file::replace(&self.path(file), &serde_json::to_vec_pretty(&known)?)?)
    }

    /// Returns the enrollments of members, and of those whose invitation can still be used.
    pub(super) fn enrolled(&self) -> anyhow::Result<BTreeMap<String, Enrollment>> {
        let ledger = self.ledger()?;
        let (open, domain) = (self.open_serials(&ledger)?, ledger.issuance_log.card().proof());
        let mut enrolled = BTreeMap::new();
        for signed in self.signed_for_members(files::ENROLLMENTS, Signed::<Enrollment>::from_pem)? {
            let claims = signed.verify_for_name(&domain)?;
            if open.contains(&claims.member) {
                enrolled.insert(claims.label.clone(), claims);
            }
        }
        Ok(enrolled)
    }

    /// Returns the serials of memberships, and of invitations that can still be used.
    pub(super) fn open_serials(&self, ledger: &DomainLedger) -> anyhow::Result<BTreeSet<u64>> {
        let now = unix_seconds();
        let service = members::stored(self)?;
        let joined: BTreeSet<u64> = service.rows(now).iter().map(|row| row.enrollment.member).collect();
        let holds = |issue: &&Issue| {
            let is_used = joined.contains(&issue.serial) || matches!(issue.to, To::Member { .. });
            let is_open = if is_used { issue.ends > now } else { issue.not_after > now };
            is_open && !issue.is_revoked(ledger.revocation.as_ref()) && !service.has_left(issue.serial)
        };
        Ok(ledger.issued.iter().filter(holds).map(|issue| issue.serial).collect())
    }
}
