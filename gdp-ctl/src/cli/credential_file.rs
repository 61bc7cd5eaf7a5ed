//! Contents of certificate files, for the commands that show, use or revoke certificates.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use gdp_core::card::NameCard;
use gdp_core::cert::{
    AdCert, CertError, Claims, Delegation, Grantee, Issued, MAX_CERT_FILE, MemberCert, Membership, PeerCert, ReadGrant,
    Reading, Revocation, RtCert, Signed,
};
use gdp_core::file_kind::FileKind;
use gdp_util::text_file;
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Map, Value};

/// Claims of a certificate, by kind: see "Certificates" in docs/wire-format.md.
pub type ClaimMap = Map<String, Value>;

/// Claims of a certificate and of the certificates that it depends on.
#[derive(Debug, Serialize, JsonSchema)]
pub struct CertificateOutput {
    /// `AdCert`, `ReadGrant`, `Delegation` …
    pub kind: &'static str,
    pub claims: ClaimMap,
    pub delegation: Option<ClaimMap>,
    /// The membership of a reader.
    pub member: Option<ClaimMap>,
    /// The invitation that a membership depends on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub invite: Option<ClaimMap>,
    /// Whether the owner of the name, or the domain, has issued it and it is valid now.
    pub verified: bool,
}

/// Output of a command that issues a certificate.
#[derive(Debug, Serialize, JsonSchema)]
pub struct IssuedOutput {
    pub kind: &'static str,
    pub claims: ClaimMap,
    /// As text, because JavaScript and jq round such numbers.
    pub serial: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
    /// The line to give to the new member; only for an invitation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub token: Option<String>,
}

impl IssuedOutput {
    /// Creates the output for a certificate in a file.
    pub fn new<T: Claims>(claims: &T, serial: u64, file: &Path) -> Self {
        let (serial, file) = (serial.to_string(), Some(file.to_path_buf()));
        Self { kind: T::KIND, claims: claim_map(claims), serial, file, token: None }
    }
}

pub fn claim_map<T: Claims>(claims: &T) -> ClaimMap {
    match serde_json::to_value(claims) {
        Ok(Value::Object(claims)) => claims,
        // All claims are structs that JSON can represent.
        _ => ClaimMap::new(),
    }
}

pub enum CredentialFile {
    Ad(Issued<AdCert>),
    Read(Reading),
    Delegation(Signed<Delegation>),
    Revocation(Signed<Revocation>),
    Member(Membership),
    Peer(Signed<PeerCert>),
    Route(Signed<RtCert>),
}

impl CredentialFile {
    pub fn load(file: &Path) -> anyhow::Result<Self> {
        let text =
            text_file::read(file, MAX_CERT_FILE as u64).with_context(|| format!("cannot read {}", file.display()))?;
        let Some(text) = text else {
            bail!("{}: longer than {MAX_CERT_FILE} bytes, so not a certificate", file.display())
        };
        Self::parse(&text).with_context(|| file.display().to_string())
    }

    fn parse(text: &str) -> anyhow::Result<Self> {
        let begins = |label: &str| text.trim_ascii_start().starts_with(&format!("-----BEGIN {label}-----"));
        Ok(match () {
            () if begins(AdCert::LABEL) => Self::Ad(Issued::from_pem(text)?),
            () if begins(ReadGrant::LABEL) => Self::Read(Reading::from_pem(text)?),
            () if begins(Delegation::LABEL) => Self::Delegation(Signed::from_pem(text)?),
            () if begins(Revocation::LABEL) => Self::Revocation(Signed::from_pem(text)?),
            () if begins(MemberCert::LABEL) => Self::Member(Membership::from_pem(text)?),
            () if begins(PeerCert::LABEL) => Self::Peer(Signed::from_pem(text)?),
            () if begins(RtCert::LABEL) => Self::Route(Signed::from_pem(text)?),
            () => match FileKind::of(text) {
                Some(kind) => bail!("it is {kind}, not a certificate"),
                None => bail!("not a certificate: no line such as \"-----BEGIN {}-----\"", AdCert::LABEL),
            },
        })
    }

    /// Returns the delegation by which a delegate issued a grant.
    pub fn delegation(&self) -> Option<Signed<Delegation>> {
        match self {
            Self::Ad(issued) => issued.delegation.clone(),
            Self::Read(reading) => reading.grant.delegation.clone(),
            _ => None,
        }
    }

    /// Returns the kind of certificate, its claims and those that it depends on, without verifying
    /// them.
    pub fn describe(&self) -> Result<CertificateOutput, CertError> {
        match self {
            Self::Ad(issued) => described(&issued.cert, issued.delegation.as_ref(), None),
            Self::Read(Reading { grant, member }) => {
                described(&grant.cert, grant.delegation.as_ref(), member.as_deref())
            }
            Self::Delegation(signed) => described(signed, None, None),
            Self::Revocation(signed) => described(signed, None, None),
            Self::Member(member) => {
                let invite = member.invite_unverified()?.as_ref().map(claim_map);
                Ok(CertificateOutput { invite, ..described(&member.cert, None, None)? })
            }
            Self::Peer(signed) => described(signed, None, None),
            Self::Route(signed) => described(signed, None, None),
        }
    }

    /// Verifies that the owner of the card's name, or the card's domain, has issued it. Returns
    /// `false` for certificates that neither signs.
    pub fn verify(&self, card: &NameCard, revocation: Option<&Revocation>, now: u64) -> Result<bool, CertError> {
        let about_card = |name| match card.name() {
            expected if expected == name => Ok(()),
            expected => Err(CertError::WrongName { expected, got: name }),
        };
        match self {
            Self::Ad(issued) => drop(issued.verify(&card.proof(), revocation, now)?),
            Self::Read(reading) => {
                let grant = reading.grant.verify(&card.proof(), revocation, now)?;
                let reader = match (&grant.to, &reading.member) {
                    (Grantee::Entity(entity), _) => Some(*entity),
                    (Grantee::Role { .. }, Some(member)) => Some(member.cert.claims_unverified()?.entity),
                    // The domain's verification follows later.
                    (Grantee::Role { .. }, None) => None,
                };
                if let Some(reader) = reader {
                    reading.verify(&card.proof(), reader, revocation, now)?;
                }
            }
            Self::Delegation(signed) => {
                let claims = signed.verify(card.owner_key(), now)?;
                about_card(claims.name)?;
                revocation.map_or(Ok(()), |revocation| revocation.check(Delegation::KIND, claims.serial))?;
            }
            Self::Revocation(signed) => about_card(signed.verify_revocation(&card.proof())?.name)?,
            Self::Member(member) => drop(member.verify(card.name(), revocation, now)?),
            Self::Peer(signed) => _ = signed.verify_peer(&card.proof(), revocation, now)?,
            Self::Route(_) => return Ok(false),
        }
        Ok(true)
    }

    /// Returns the serial of a certificate of the card's name, also if it is no longer valid.
    pub fn serial(&self, card: &NameCard) -> anyhow::Result<u64> {
        let (name, serial) = match self {
            Self::Ad(issued) => issued.cert.claims_unverified().map(|claims| (claims.name, claims.serial))?,
            Self::Read(reading) => reading.grant.cert.claims_unverified().map(|claims| (claims.name, claims.serial))?,
            Self::Delegation(signed) => signed.claims_unverified().map(|claims| (claims.name, claims.serial))?,
            Self::Revocation(_) | Self::Member(_) | Self::Peer(_) | Self::Route(_) => {
                bail!("no owner of a name can revoke this")
            }
        };
        if name != card.name() {
            bail!("the certificate is about {name}, not about the card's name {}", card.name());
        }
        Ok(serial)
    }

    /// Returns the serial, as [`Self::serial`] does, for certificates of this domain.
    pub fn domain_serial(&self, domain: Name) -> anyhow::Result<u64> {
        let (of, serial) = match self {
            Self::Member(member) => (member.domain.name()?, member.serial_unverified()?),
            Self::Peer(signed) => signed.claims_unverified().map(|claims| (claims.domain, claims.serial))?,
            _ => bail!("no domain can revoke this"),
        };
        if of != domain {
            bail!("it is of domain {of}, not of {domain}");
        }
        Ok(serial)
    }
}

fn described<T: Claims>(
    signed: &Signed<T>,
    delegation: Option<&Signed<Delegation>>,
    member: Option<&Membership>,
) -> Result<CertificateOutput, CertError> {
    Ok(CertificateOutput {
        kind: T::KIND,
        claims: claim_map(&signed.claims_unverified()?),
        delegation: delegation.map(Signed::claims_unverified).transpose()?.as_ref().map(claim_map),
        member: member.map(|member| member.cert.claims_unverified()).transpose()?.as_ref().map(claim_map),
        invite: None,
        verified: false,
    })
}
