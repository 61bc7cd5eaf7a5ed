//! This switch's domain membership: it admits peers, and proves the membership to others.

use std::net::SocketAddr;

use gdp_core::cert::domain::roles;
use gdp_core::cert::{self, CertError, Host, Revocation, Signed, SwitchStatement, issue};
use gdp_core::identity::Identity;
use gdp_core::name::NameProof;
use gdp_core::peer::Role;
use gdp_link::link::Link;
use gdp_proto::control::{RefusalCode, Request};
use gdp_util::unix_time::{unix_nanos, unix_seconds};
use gdp_wire::Name;

use super::follow_up::{FollowUp, refuse};
use crate::config::Inside;
use crate::domain::{Admission, Admitted, Credentials, Domain};

/// The domain membership of a switch, if it has one.
#[derive(Default)]
pub struct Membership {
    /// The domain. Without one, the switch accepts links from all configured neighbours and all
    /// endpoints.
    pub domain: Option<Domain>,
    /// The switch has no domain, and other machines can reach it.
    pub is_open: bool,
    /// The addresses at which other domains reach this border.
    public: Vec<SocketAddr>,
    /// What other domains see of this domain when they trace names through this switch.
    pub trace_visibility: Inside,
    /// The statement that the RIB may show other domains, with the membership certificate behind
    /// it.
    statement: Option<Host>,
}

impl Membership {
    pub fn new(domain: Domain, public: Vec<SocketAddr>, trace_visibility: Inside) -> Self {
        Self { domain: Some(domain), is_open: false, public, trace_visibility, statement: None }
    }

    pub fn home(&self) -> Option<Name> {
        self.domain.as_ref().map(|domain| domain.trust.home())
    }

    /// Returns the relationship that a peer's credentials give it on a link. Fails with the reason
    /// if they give none.
    pub fn admit(&self, link: &Link, credentials: Option<&Credentials>) -> Result<Admission, String> {
        let Some(domain) = &self.domain else { return Ok(Admission::STRANGER) };
        let admitted = domain.trust.admit(Role::Switch, link.peer(), credentials, unix_seconds());
        admitted.map_err(|error| error.to_string())
    }

    /// Returns the request by which switch `own` asks the RIB to confirm a member that an
    /// invitation admitted. Returns `None` if the peer has no invitation of this domain, or its
    /// admission is already known.
    pub fn question(&self, own: Name, link: &Link, credentials: &Credentials) -> Option<Request> {
        let domain = self.domain.as_ref()?;
        let (entity, membership) = (link.peer().name, &credentials.membership);
        let invite = membership.invite_unverified().ok()??;
        let is_own = membership.domain.name().is_ok_and(|name| name == domain.trust.home());
        let until = membership.until_unverified().ok()?;
        let is_known = domain.invitations.has_admitted(invite.serial, &entity, until);
        (is_own && !is_known).then(|| Request::Admitted {
            switch: own,
            entity,
            membership: Box::new(membership.clone()),
        })
    }

    /// Answers a switch that asks the local RIB to confirm an admission by invitation.
    pub fn admit_invited(&mut self, entity: Name, membership: &cert::Membership, now: u64) -> FollowUp {
        let Some(domain) = &mut self.domain else {
            return refuse(RefusalCode::Unsupported, "the RIB here is of no domain: configure domain");
        };
        let home = domain.trust.home();
        let cert = match membership.verify(home, domain.trust.revocation(&home), now) {
            Ok(cert) => cert,
            Err(error) => return refuse(RefusalCode::NotEntitled, error.to_string()),
        };
        let Ok(Some(invite)) = membership.invite_unverified() else {
            return refuse(RefusalCode::Malformed, "the membership rests on no invitation");
        };
        if cert.entity != entity {
            return refuse(RefusalCode::WrongEntity, format!("the membership is of {}, not of {entity}", cert.entity));
        }
        let known = domain.invitations.get(invite.serial).is_some();
        let admitted = Admitted { entity, until: cert.not_after };
        match domain.invitations.admit(&invite, admitted, now) {
            Ok(changed) => {
                domain.changes += u64::from(changed);
                FollowUp::SaveInvitation { new: (changed && !known).then_some(invite.serial) }
            }
            Err(reason) => refuse(RefusalCode::NotEntitled, reason.to_string()),
        }
    }

    /// Accepts a revocation by a domain. Returns whether it is new, or `None` if this switch has no
    /// domain.
    pub fn take_revocation(
        &mut self,
        proof: &NameProof,
        revocation: &Signed<Revocation>,
    ) -> Option<Result<bool, CertError>> {
        let domain = self.domain.as_mut()?;
        let accepted = domain.trust.take_revocation(proof, revocation);
        Some(accepted.inspect(|is_news| domain.changes += u64::from(*is_news)))
    }

    /// Returns the statement of this switch that the RIB may show other domains. Returns `None`
    /// without a domain or a valid membership. Issues a new statement whenever the membership is
    /// renewed, and so before the old statement expires.
    pub fn statement(&mut self, identity: &Identity) -> Option<Host> {
        let domain = self.domain.as_ref()?;
        let membership = &domain.trust.credentials().membership;
        if self.statement.as_ref().is_none_or(|statement| statement.membership != *membership) {
            let own = domain.trust.own(unix_seconds()).ok()?;
            let addresses = if own.role == roles::BORDER { self.public.clone() } else { Vec::new() };
            let (switch, serial) = (identity.name(), unix_nanos());
            let claims = SwitchStatement { switch, domain: own.domain, addresses, serial, not_after: own.not_after };
            let statement = issue(identity.key(), &claims).ok()?;
            self.statement = Some(Host { proof: identity.proof(), statement, membership: membership.clone() });
        }
        self.statement.clone()
    }
}
