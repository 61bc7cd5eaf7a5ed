//! Trust domains as their members apply them: the credentials that an entity presents on its links
//! ([`Credentials`]), and the peers it accepts ([`Trust`]). It has no I/O and no clock. Switches
//! and nodes call it. The certificates are in [`crate::cert::domain`], the invitation that a person
//! passes on in [`token`].

mod files;
pub mod token;

use std::collections::BTreeMap;
use std::sync::Arc;

use parking_lot::Mutex;
use serde::{Deserialize, Serialize};

use crate::cert::domain::roles;
use crate::cert::{CertError, MemberCert, Membership, PeerCert, PeerRights, Revocation, Signed};
use crate::name::{Name, NameProof};
use crate::peer::{Peer, Role};
use crate::revocations::SignedRevocation;

pub use files::{CredentialFiles, PaperFileError};
pub use token::{Enrolling, Token, TokenError};

/// Maximum number of certificates for other domains that one entity presents.
pub const MAX_PEERS: usize = 16;

/// Maximum bytes of all signed parts that one entity presents.
pub const MAX_PAPERS: usize = 12 << 10;

/// Credentials of its domain that an entity presents on a link.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Credentials {
    pub membership: Membership,
    /// Rights that its domain grants to other domains.
    pub peers: Vec<Signed<PeerCert>>,
}

impl Credentials {
    pub fn check_bounds(&self) -> Result<(), CertError> {
        let size = self.membership.size() + self.peers.iter().map(|peer| peer.as_bytes().len()).sum::<usize>();
        if self.peers.len() > MAX_PEERS || size > MAX_PAPERS {
            return Err(CertError::Malformed(format!(
                "{} peer certificates, {size} bytes in all, where {MAX_PEERS} and {MAX_PAPERS} are allowed",
                self.peers.len()
            )));
        }
        Ok(())
    }
}

/// Credentials that an entity presents at present on all its ports. Clones share the same state.
#[derive(Clone, Debug, Default)]
pub struct CurrentCredentials(Arc<Mutex<Option<Arc<Credentials>>>>);

impl CurrentCredentials {
    pub fn get(&self) -> Option<Arc<Credentials>> {
        self.0.lock().clone()
    }

    pub fn set(&self, credentials: Arc<Credentials>) {
        *self.0.lock() = Some(credentials);
    }
}

/// Relationship of a peer to this side's domain.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Relationship {
    /// The peer presents no credentials of a domain and needs none.
    Stranger,
    Member {
        role: String,
    },
    /// Border switch of another domain. `ours` are the rights that this domain grants that one,
    /// `theirs` the reverse.
    Border {
        domain: Name,
        ours: PeerRights,
        theirs: PeerRights,
    },
    /// Endpoint of another domain.
    Visitor {
        domain: Name,
    },
    /// Switch of another domain that this endpoint visits.
    Host {
        domain: Name,
    },
}

impl Relationship {
    pub fn as_str(&self) -> &'static str {
        match self {
            Self::Stranger => "stranger",
            Self::Member { .. } => "member",
            Self::Border { .. } => "border",
            Self::Visitor { .. } => "visitor",
            Self::Host { .. } => "host",
        }
    }

    pub fn is_border(&self) -> bool {
        matches!(self, Self::Border { .. })
    }
}

/// Permission for a link with a peer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Admission {
    pub relationship: Relationship,
    /// Last Unix second at which all of it is valid.
    pub until: u64,
}

impl Admission {
    /// Admission of a peer that needs no credentials.
    pub const STRANGER: Self = Self { relationship: Relationship::Stranger, until: u64::MAX };
}

/// Reason why a peer is refused a link, or why an entity's own credentials do not apply. Both sides
/// read it: it names the certificate and the remedy.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DomainError {
    #[error(
        "{peer:#} shows no membership, and this is for members of domain {home:#}: have that domain admit it \
         (`gdp-ctl domain admit` or `invite`)"
    )]
    NoMembership { peer: Name, home: Name },
    #[error("the {what} with serial {serial} of {of:#}, issued by domain {domain:#}: {source}")]
    Paper { what: &'static str, serial: u64, of: Name, domain: Name, source: Box<CertError> },
    #[error("what {of:#} shows of its domain cannot be read: {source}")]
    Unreadable { of: Name, source: Box<CertError> },
    #[error(
        "{peer:#} is {role} in domain {domain:#}, and a switch there has the role switch, rib or border: have it \
         admitted as one"
    )]
    NotASwitch { peer: Name, role: String, domain: Name },
    #[error(
        "{peer:#} is of domain {domain:#}, which domain {home:#} does not know: issue `gdp-ctl domain peer {domain}` \
         with the key of {home:#}, and list it under peers"
    )]
    Foreign { peer: Name, domain: Name, home: Name },
    #[error(
        "domain {domain:#} has not issued a PeerCert to domain {home:#}, or {peer:#} does not show it: issue it with \
         the key of {domain:#}, and list it under peers there"
    )]
    OneSided { peer: Name, domain: Name, home: Name },
    #[error(
        "the PeerCert with serial {serial} of domain {domain:#} gives domain {to:#} {has}, and {right} is needed: \
         have one issued with it"
    )]
    NoRight { domain: Name, to: Name, serial: u64, has: PeerRights, right: &'static str },
    #[error(
        "{of:#} is {role} in domain {domain:#}, and links between domains are for border switches: have it admitted with role border"
    )]
    NotABorder { of: Name, role: String, domain: Name },
}

/// Policy of an entity for accepting links, based on the domain of which it is a member.
#[derive(Debug)]
pub struct Trust {
    entity: Name,
    home: Name,
    credentials: Arc<Credentials>,
    members_only: bool,
    revocations: BTreeMap<Name, (SignedRevocation, Revocation)>,
}

impl Trust {
    /// Creates the policy of an entity with these credentials. `members_only` states that no
    /// endpoint gets a link without a membership.
    ///
    /// The validity period is checked with each link, because a machine may start without a clock.
    pub fn new(entity: Name, credentials: Arc<Credentials>, members_only: bool) -> Result<Self, DomainError> {
        let home = check_own(entity, &credentials)?;
        Ok(Self { entity, home, credentials, members_only, revocations: BTreeMap::new() })
    }

    /// Replaces the credentials by renewed ones, and the configured `members_only`.
    pub fn renew(&mut self, credentials: Arc<Credentials>, members_only: bool) -> Result<(), DomainError> {
        let home = check_own(self.entity, &credentials)?;
        (self.home, self.credentials, self.members_only) = (home, credentials, members_only);
        Ok(())
    }

    pub fn home(&self) -> Name {
        self.home
    }

    pub fn credentials(&self) -> &Arc<Credentials> {
        &self.credentials
    }

    pub fn members_only(&self) -> bool {
        self.members_only
    }

    /// Returns this entity's own membership certificate, if it is valid at `now` (Unix seconds).
    pub fn own(&self, now: u64) -> Result<MemberCert, DomainError> {
        self.member(self.entity, &self.credentials.membership, self.home, now)
    }

    /// Decides whether `peer` may have a link with this entity. `own` is this entity's role on
    /// links, `shown` are the peer's credentials.
    pub fn admit(
        &self,
        own: Role,
        peer: &Peer,
        shown: Option<&Credentials>,
        now: u64,
    ) -> Result<Admission, DomainError> {
        let Some(shown) = shown else {
            if own == Role::Switch && peer.role == Role::Endpoint && !self.members_only {
                return Ok(Admission::STRANGER);
            }
            return Err(DomainError::NoMembership { peer: peer.name, home: self.home });
        };
        let own_cert = self.own(now)?;
        let unreadable = |source: CertError| DomainError::Unreadable { of: peer.name, source: source.into() };
        shown.check_bounds().map_err(unreadable)?;
        let domain = shown.membership.domain.name().map_err(|error| unreadable(error.into()))?;
        if domain == self.home {
            let cert = self.member(peer.name, &shown.membership, domain, now)?;
            if peer.role == Role::Switch && !roles::is_switch(&cert.role) {
                return Err(DomainError::NotASwitch { peer: peer.name, role: cert.role, domain });
            }
            let until = own_cert.not_after.min(cert.not_after);
            return Ok(Admission { relationship: Relationship::Member { role: cert.role }, until });
        }
        let home = self.home;
        let ours = self.granted(&self.credentials, home, domain, now)?.ok_or(DomainError::Foreign {
            peer: peer.name,
            domain,
            home,
        })?;
        let cert = self.member(peer.name, &shown.membership, domain, now)?;
        if peer.role == Role::Switch && !roles::is_switch(&cert.role) {
            return Err(DomainError::NotASwitch { peer: peer.name, role: cert.role, domain });
        }
        let mut until = own_cert.not_after.min(ours.not_after).min(cert.not_after);
        let relationship = match (own, peer.role) {
            (Role::Switch, Role::Switch) => {
                let theirs = self.granted(shown, domain, home, now)?.ok_or(DomainError::OneSided {
                    peer: peer.name,
                    domain,
                    home,
                })?;
                for cert in [&ours, &theirs] {
                    needs(cert, cert.rights.peering, "peering")?;
                }
                for (of, cert, domain) in [(self.entity, &own_cert, home), (peer.name, &cert, domain)] {
                    if cert.role != roles::BORDER {
                        return Err(DomainError::NotABorder { of, role: cert.role.clone(), domain });
                    }
                }
                until = until.min(theirs.not_after);
                Relationship::Border { domain, ours: ours.rights, theirs: theirs.rights }
            }
            (Role::Switch, Role::Endpoint) => {
                needs(&ours, ours.rights.visit, "visit")?;
                Relationship::Visitor { domain }
            }
            // Only the host can decide whether this entity may visit.
            (Role::Endpoint, _) => Relationship::Host { domain },
        };
        Ok(Admission { relationship, until })
    }

    /// Verifies and stores a domain's revocation. Returns whether it is new. Revocations of
    /// unrelated domains are ignored.
    pub fn take_revocation(&mut self, proof: &NameProof, signed: &Signed<Revocation>) -> Result<bool, CertError> {
        // Anybody may send a revocation. This check keeps unrelated ones cheap.
        if !self.knows(&proof.name()?) {
            return Ok(false);
        }
        let kept = SignedRevocation { proof: *proof, revocation: signed.clone(), origin: None };
        let claims = kept.verify()?;
        let held = self.revocation(&claims.name);
        claims.check_replaces(held)?;
        if held == Some(&claims) {
            return Ok(false);
        }
        self.revocations.insert(claims.name, (kept, claims));
        Ok(true)
    }

    /// Returns whether a domain is this entity's own, or one to which its domain has granted
    /// rights.
    pub fn knows(&self, domain: &Name) -> bool {
        let is_peer = |signed: &Signed<PeerCert>| signed.claims_unverified().is_ok_and(|claims| claims.peer == *domain);
        *domain == self.home || self.credentials.peers.iter().any(is_peer)
    }

    /// Returns the newest revocation of each domain, with the proof of the domain's name.
    pub fn revocations(&self) -> impl Iterator<Item = &SignedRevocation> {
        self.revocations.values().map(|(kept, _)| kept)
    }

    pub fn revocation(&self, domain: &Name) -> Option<&Revocation> {
        self.revocations.get(domain).map(|(_, claims)| claims)
    }

    /// Verifies the membership of `of` in `domain` and returns its certificate.
    fn member(&self, of: Name, membership: &Membership, domain: Name, now: u64) -> Result<MemberCert, DomainError> {
        let unreadable = |source: CertError| DomainError::Unreadable { of, source: source.into() };
        let serial = membership.serial_unverified().map_err(unreadable)?;
        let what = if membership.invite.is_some() { "invitation" } else { "MemberCert" };
        let wrong = |source: CertError| DomainError::Paper { what, serial, of, domain, source: source.into() };
        let cert = membership.verify(domain, self.revocation(&domain), now).map_err(wrong)?;
        if cert.entity != of {
            return Err(wrong(CertError::WrongEntity { expected: of, got: cert.entity }));
        }
        Ok(cert)
    }

    /// Returns the rights that `domain` grants `to`, from the credentials of one of its members. Of
    /// several valid certificates the newest counts.
    fn granted(
        &self,
        credentials: &Credentials,
        domain: Name,
        to: Name,
        now: u64,
    ) -> Result<Option<PeerCert>, DomainError> {
        let (mut newest, mut failure) = (None::<PeerCert>, None);
        for signed in &credentials.peers {
            let Ok(claims) = signed.claims_unverified() else { continue };
            if claims.peer != to || newest.as_ref().is_some_and(|newest| newest.serial > claims.serial) {
                continue;
            }
            match signed.verify_peer(&credentials.membership.domain, self.revocation(&domain), now) {
                Ok(claims) => newest = Some(claims),
                Err(source) => {
                    let (what, serial, source) = ("PeerCert", claims.serial, source.into());
                    failure = Some(DomainError::Paper { what, serial, of: to, domain, source });
                }
            }
        }
        if newest.is_some() {
            return Ok(newest);
        }
        failure.map_or(Ok(None), Err)
    }
}

fn needs(cert: &PeerCert, held: bool, right: &'static str) -> Result<(), DomainError> {
    let PeerCert { domain, peer: to, serial, rights: has, .. } = *cert;
    if held { Ok(()) } else { Err(DomainError::NoRight { domain, to, serial, has, right }) }
}

/// Verifies the signatures in an entity's own credentials and returns their domain.
fn check_own(entity: Name, credentials: &Credentials) -> Result<Name, DomainError> {
    let unreadable = |source: CertError| DomainError::Unreadable { of: entity, source: source.into() };
    credentials.check_bounds().map_err(unreadable)?;
    let domain = credentials.membership.domain.name().map_err(|error| unreadable(error.into()))?;
    let cert = credentials.membership.verify_signatures(domain).map_err(unreadable)?;
    if cert.entity != entity {
        return Err(unreadable(CertError::WrongEntity { expected: entity, got: cert.entity }));
    }
    for signed in &credentials.peers {
        let claims = signed.verify_for_name(&credentials.membership.domain).map_err(unreadable)?;
        if claims.domain != domain {
            return Err(unreadable(CertError::WrongDomain { expected: domain, got: claims.domain }));
        }
    }
    Ok(domain)
}

#[cfg(test)]
#[path = "../../tests/unit/domain.rs"]
mod tests;
