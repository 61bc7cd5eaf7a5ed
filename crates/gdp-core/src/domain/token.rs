//! Invitation as one line of text: `gdp1` and base64url (RFC 4648 §5, no padding) of deterministic
//! CBOR. It holds a private key, so anyone who has the line can be admitted.

use base64ct::{Base64UrlUnpadded, Encoding};
use serde::{Deserialize, Serialize};
use zeroize::{Zeroize, Zeroizing};

use crate::card::NameCard;
use crate::cbor;
use crate::cbor::CborError;
use crate::cert::{CertError, Delegation, Enrollment, Invite, MemberCert, Membership, Signed, issue};
use crate::identity::SigningKey;
use crate::link_target::LinkTarget;
use crate::name::{Name, NameProof, domain_metadata, inner_digest};
use crate::peer::MAX_LANES;
use crate::verify_key::VerifyKey;

const PREFIX: &str = "gdp1";

/// Maximum bytes of the CBOR; a typical invitation has about 700, with an enrollment 1300.
const MAX_TOKEN: usize = 4096;

#[derive(Debug, thiserror::Error)]
pub enum TokenError {
    #[error("not an invitation: it is one line that begins with gdp1, as `gdp-ctl domain invite` prints it")]
    NotAToken,
    #[error("the invitation is damaged ({0}); copy the whole line")]
    Damaged(String),
    #[error(transparent)]
    Cert(#[from] CertError),
}

impl From<CborError> for TokenError {
    fn from(error: CborError) -> Self {
        Self::Damaged(error.to_string())
    }
}

/// Invitation with its private key and the address of the fabric.
#[derive(Clone, Debug)]
pub struct Token {
    domain: NameProof,
    invite: Signed<Invite>,
    key: SigningKey,
    at: LinkTarget,
    /// Further addresses of the same switch.
    also: Vec<LinkTarget>,
    switch: Option<Name>,
    enrolling: Option<Enrolling>,
    successor: Option<VerifyKey>,
}

/// Part of an invitation that also enrolls the new member in the domain's directory.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Enrolling {
    pub enrollment: Signed<Enrollment>,
    /// Delegation by the join service to the invitation's key: its holder may call the service.
    pub call: Signed<Delegation>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Form {
    domain: NameProof,
    invite: Signed<Invite>,
    #[serde(with = "crate::cbor::array")]
    key: [u8; 32],
    at: String,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    also: Vec<String>,
    switch: Option<Name>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    enrolling: Option<Enrolling>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    successor: Option<VerifyKey>,
}

impl Drop for Form {
    fn drop(&mut self) {
        self.key.zeroize();
    }
}

impl Token {
    /// Creates a token. `at` is the address of the fabric, `switch` the entity that must answer
    /// there.
    pub fn new(
        domain: NameProof,
        invite: Signed<Invite>,
        key: SigningKey,
        at: LinkTarget,
        switch: Option<Name>,
    ) -> Result<Self, CertError> {
        let also = Vec::new();
        let token = Self { domain, invite, key, at, also, switch, enrolling: None, successor: None };
        token.invite()?;
        Ok(token)
    }

    /// Verifies the invitation, regardless of time, and returns its claims.
    pub fn invite(&self) -> Result<Invite, CertError> {
        let domain = self.domain.name()?;
        let claims = self.invite.verify_for_name(&self.domain)?;
        if claims.domain != domain {
            return Err(CertError::WrongDomain { expected: domain, got: claims.domain });
        }
        let got = self.key.verify_key();
        if claims.key != got {
            return Err(CertError::WrongKey { what: "Invite", expected: claims.key.to_string(), got: got.to_string() });
        }
        Ok(claims)
    }

    /// Returns the invitation as it was signed.
    pub fn invite_signed(&self) -> &Signed<Invite> {
        &self.invite
    }

    /// Adds the enrollment, after a check that it is of this invitation.
    pub fn enroll(self, enrolling: Enrolling) -> Result<Self, CertError> {
        let invite = self.invite()?;
        let claims = enrolling.enrollment.verify_for_name(&self.domain)?;
        if (claims.domain, claims.member) != (invite.domain, invite.serial) {
            return Err(CertError::Malformed("the enrollment is of another invitation".into()));
        }
        Ok(Self { enrolling: Some(enrolling), ..self })
    }

    /// Adds further addresses of the switch, in order of preference after [`Self::at`]. A node has
    /// no use for more than [`MAX_LANES`] addresses.
    pub fn also(self, mut also: Vec<LinkTarget>) -> Self {
        also.truncate(MAX_LANES - 1);
        Self { also, ..self }
    }

    /// Returns the enrollment, if the domain enrolls this member.
    pub fn enrolling(&self) -> Option<&Enrolling> {
        self.enrolling.as_ref()
    }

    /// Returns the key of the invitation.
    pub fn key(&self) -> &SigningKey {
        &self.key
    }

    pub fn domain(&self) -> &NameProof {
        &self.domain
    }

    /// Adds the key that succeeds the domain's, which is part of the domain's card.
    pub fn with_successor(self, successor: Option<VerifyKey>) -> Self {
        Self { successor, ..self }
    }

    pub fn successor(&self) -> Option<VerifyKey> {
        self.successor
    }

    /// Returns the card of the domain.
    pub fn domain_card(&self) -> Result<NameCard, CertError> {
        let metadata = domain_metadata(self.successor.as_ref());
        if inner_digest(&metadata) != self.domain.digest {
            return Err(CertError::Malformed("who invites is no domain".into()));
        }
        NameCard::new(self.domain.verify_key()?, metadata).map_err(|error| CertError::Malformed(error.to_string()))
    }

    /// Returns the preferred address.
    pub fn at(&self) -> &LinkTarget {
        &self.at
    }

    /// Returns all addresses, in order of preference.
    pub fn addresses(&self) -> impl Iterator<Item = &LinkTarget> {
        [&self.at].into_iter().chain(&self.also)
    }

    pub fn switch(&self) -> Option<Name> {
        self.switch
    }

    /// Issues a membership to `entity`. `serial` is the time in nanoseconds, at which the
    /// invitation must be valid.
    pub fn admit(&self, entity: Name, not_before: u64, serial: u64) -> Result<Membership, CertError> {
        let invite = self.invite()?;
        let now = serial / 1_000_000_000;
        crate::cert::Claims::check_time(&invite, now)?;
        let Invite { domain, role, serial: invited, member_until: not_after, .. } = invite;
        let claims = MemberCert { domain, entity, role, serial: serial.max(invited), not_before, not_after };
        let cert = issue(&self.key, &claims)?;
        let membership = Membership { domain: self.domain, cert, invite: Some(self.invite.clone()), renewal: None };
        membership.verify(domain, None, now)?;
        Ok(membership)
    }

    /// Returns the line of text. Keep it out of logs and process lists.
    pub fn to_line(&self) -> Zeroizing<String> {
        let form = Form {
            domain: self.domain,
            invite: self.invite.clone(),
            key: *self.key.secret_bytes(),
            at: self.at.to_string(),
            also: self.also.iter().map(ToString::to_string).collect(),
            switch: self.switch,
            enrolling: self.enrolling.clone(),
            successor: self.successor,
        };
        let bytes = Zeroizing::new(cbor::encode(&form).expect("byte strings and text have an encoding"));
        let encoded = Zeroizing::new(Base64UrlUnpadded::encode_string(&bytes));
        Zeroizing::new(format!("{PREFIX}{}", *encoded))
    }

    /// Parses a line and verifies the domain's signature in it. Errors contain nothing of the line.
    pub fn from_line(line: &str) -> Result<Self, TokenError> {
        let encoded = line.trim().strip_prefix(PREFIX).ok_or(TokenError::NotAToken)?;
        if encoded.len() > 2 * MAX_TOKEN {
            return Err(TokenError::Damaged("it is too long".into()));
        }
        let bytes = Base64UrlUnpadded::decode_vec(encoded)
            .map(Zeroizing::new)
            .map_err(|_| TokenError::Damaged("not base64url".into()))?;
        let form: Form =
            cbor::decode(&bytes, MAX_TOKEN).map_err(|_| TokenError::Damaged("not an invitation".into()))?;
        let damaged = |what: &str| TokenError::Damaged(what.into());
        let key = SigningKey::from_secret_bytes(&form.key).map_err(|_| damaged("its key is none"))?;
        let address = |text: &String| text.parse().map_err(|_| damaged("it names no address to dial"));
        let at = address(&form.at)?;
        let also = form.also.iter().map(address).collect::<Result<_, _>>()?;
        let token = Self::new(form.domain, form.invite.clone(), key, at, form.switch)?.also(also);
        let token = token.with_successor(form.successor);
        Ok(match form.enrolling.clone() {
            Some(enrolling) => token.enroll(enrolling)?,
            None => token,
        })
    }
}
