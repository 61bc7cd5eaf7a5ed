//! The node's trust domain, if it is a member of one: the node's own credentials, and the admission
//! of switches.

use std::sync::Arc;
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use tokio::sync::watch;
use tokio::time::sleep_until;

use gdp_core::cert::{CertError, Revocation, Signed};
use gdp_core::domain::{Admission, Credentials, CurrentCredentials, DomainError, Trust};
use gdp_core::identity::Identity;
use gdp_core::name::NameProof;
use gdp_core::peer::Role;
use gdp_core::revocations::SignedRevocation;
use gdp_link::link::{CloseCode, Link};
use gdp_util::ticks::next_tick;
use gdp_util::unix_time::unix_seconds;

/// Interval of the checks whether a link's admission has ended. Its end is a time of the wall
/// clock, which may step.
const LOOK: Duration = Duration::from_secs(1);

pub struct Home {
    trust: Option<Mutex<Trust>>,
    /// The credentials, shared with the ports of the node's links.
    pub credentials: CurrentCredentials,
    /// Notified of every change that may affect an admission.
    changes: watch::Sender<()>,
}

impl Home {
    /// Creates the node's trust state. Without credentials, the node accepts any switch.
    pub fn new(identity: &Identity, shown: Option<Credentials>) -> Result<Self, DomainError> {
        let credentials = CurrentCredentials::default();
        let trust = match shown.map(Arc::new) {
            Some(shown) => {
                credentials.set(shown.clone());
                // A node is not a switch and admits no guests.
                Some(Mutex::new(Trust::new(identity.name(), shown, true)?))
            }
            None => None,
        };
        Ok(Self { trust, credentials, changes: watch::Sender::default() })
    }

    /// Checks whether the switch at the other end may have the link.
    pub fn admit(&self, link: &Link) -> Result<Admission, DomainError> {
        self.admit_by(link, link.credentials().as_deref())
    }

    fn admit_by(&self, link: &Link, shown: Option<&Credentials>) -> Result<Admission, DomainError> {
        match &self.trust {
            Some(trust) => trust.lock().admit(Role::Endpoint, link.peer(), shown, unix_seconds()),
            None => Ok(Admission::STRANGER),
        }
    }

    /// Returns when the node's own membership ends, in Unix seconds, or why it is not valid. `None`
    /// without a domain.
    pub fn member_until(&self) -> Option<Result<u64, DomainError>> {
        let own = self.trust.as_ref()?.lock().own(unix_seconds());
        Some(own.map(|member| member.not_after))
    }

    /// Replaces the credentials. A node without credentials stays without.
    pub fn renew(&self, credentials: Arc<Credentials>) -> Result<(), DomainError> {
        if let Some(trust) = &self.trust {
            trust.lock().renew(credentials.clone(), true)?;
            self.credentials.set(credentials);
            self.changed();
        }
        Ok(())
    }

    /// Processes renewed credentials of the switch.
    pub fn take_credentials(&self, link: &Link, credentials: Credentials) -> Result<(), DomainError> {
        self.admit_by(link, Some(&credentials))?;
        link.set_credentials(Arc::new(credentials));
        self.changed();
        Ok(())
    }

    /// Processes a revocation by a domain. Returns it if it is new and concerns a domain of this
    /// node.
    pub fn take_revocation(
        &self,
        proof: &NameProof,
        revocation: &Signed<Revocation>,
    ) -> Result<Option<Revocation>, CertError> {
        let Some(trust) = &self.trust else { return Ok(None) };
        if !trust.lock().take_revocation(proof, revocation)? {
            return Ok(None);
        }
        self.changed();
        Ok(self.revocations().into_iter().find(|claims| Ok(claims.name) == proof.name()))
    }

    /// Returns the known revocations of the domains that concern this node.
    pub fn revocations(&self) -> Vec<Revocation> {
        let Some(trust) = &self.trust else { return Vec::new() };
        let trust = trust.lock();
        let of = |kept: &SignedRevocation| trust.revocation(&kept.proof.name().ok()?).cloned();
        trust.revocations().filter_map(of).collect()
    }

    /// Closes the link, with the reason, when its admission expires or is revoked.
    pub async fn watch(&self, link: &Link) {
        let (mut until, mut changes) = (0, self.changes.subscribe());
        changes.mark_changed();
        loop {
            if unix_seconds() > until || changes.has_changed().unwrap_or(false) {
                changes.mark_unchanged();
                match self.admit(link) {
                    Ok(admission) => until = admission.until,
                    Err(error) => return link.refuse(CloseCode::NotAdmitted, &error.to_string()),
                }
            }
            // The sender lives as long as this.
            tokio::select! {
                () = sleep_until(next_tick(LOOK, Instant::now()).into()) => {}
                _ = changes.changed() => changes.mark_changed(),
            }
        }
    }

    fn changed(&self) {
        self.changes.send_replace(());
    }
}
