//! The certificate that lets a route write or read its name.

use crate::config::Side;
use gdp_core::card::NameCard;
use gdp_core::cert::{AboutName, AdCert, CertError, Claims as _, Issued, MAX_CERT_FILE, Reading};
use gdp_core::file_kind::FileKind;
use gdp_util::unix_time::unix_seconds;
use gdp_wire::Name;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// A certificate by which the owner of a name allows this proxy to write or read it.
#[derive(Clone, PartialEq)]
pub enum Permission {
    Publish(Issued<AdCert>),
    Read(Reading),
}

impl Permission {
    /// Returns the direction that the certificate permits.
    pub fn side(&self) -> Side {
        match self {
            Self::Publish(_) => Side::Out,
            Self::Read(_) => Side::In,
        }
    }

    /// Returns when the first certificate of the chain ends, in Unix seconds. `None` if one cannot
    /// be read.
    pub fn until(&self) -> Option<u64> {
        match self {
            Self::Publish(cert) => end(cert),
            Self::Read(grant) => {
                let member = grant.member.as_ref().map(|member| member.until_unverified()).transpose().ok()?;
                Some(end(&grant.grant)?.min(member.unwrap_or(u64::MAX)))
            }
        }
    }

    /// Returns the certificate to publish, or `None` if it is one to read.
    pub fn publish(self) -> Option<Issued<AdCert>> {
        match self {
            Self::Publish(cert) => Some(cert),
            Self::Read(_) => None,
        }
    }

    /// Returns the grant to read, or `None` if it is a certificate to publish.
    pub fn read(self) -> Option<Reading> {
        match self {
            Self::Publish(_) => None,
            Self::Read(grant) => Some(grant),
        }
    }
}

fn end<T: AboutName>(issued: &Issued<T>) -> Option<u64> {
    let cert = issued.cert.claims_unverified().ok()?.validity();
    let delegation = issued.delegation.as_ref().map(|delegation| delegation.claims_unverified());
    let delegation = delegation.transpose().ok()?.map_or(u64::MAX, |delegation| delegation.validity().not_after);
    Some(cert.not_after.min(delegation))
}

/// Reads and checks the certificate file of one direction of a topic.
pub fn load_permission(path: &Path, side: Side, card: &NameCard, entity: Name) -> Result<Permission, String> {
    let mut text = String::new();
    let file = File::open(path).map_err(|error| error.to_string())?;
    file.take(MAX_CERT_FILE as u64 + 1).read_to_string(&mut text).map_err(|error| error.to_string())?;
    let (wanted, right) = match side {
        Side::Out => (FileKind::AdCert, "--publish"),
        Side::In => (FileKind::ReadGrant, "--read"),
    };
    let remedy = || format!("have the owner run `gdp-ctl grant add CARD {right} --entity {entity} -o FILE`");
    if let Some(kind) = FileKind::of(&text).filter(|kind| *kind != wanted) {
        return Err(format!("it is {kind}, and {wanted} is needed; {}", remedy()));
    }
    check_permission(side, &text, card, entity, unix_seconds()).map_err(|error| match error {
        CertError::WrongEntity { expected, got } => {
            format!("wrong entity: it was issued to {got:#}, and this proxy is {expected:#}; {}", remedy())
        }
        other => other.to_string(),
    })
}

/// Checks that the PEM `text` lets `entity` write or read the name of `card` at `now`, in Unix
/// seconds.
pub fn check_permission(
    side: Side,
    text: &str,
    card: &NameCard,
    entity: Name,
    now: u64,
) -> Result<Permission, CertError> {
    match side {
        Side::Out => {
            let cert = Issued::<AdCert>::from_pem(text)?;
            cert.verify_for(&card.proof(), entity, None, now)?;
            Ok(Permission::Publish(cert))
        }
        Side::In => {
            let grant = Reading::from_pem(text)?;
            grant.verify(&card.proof(), entity, None, now)?;
            Ok(Permission::Read(grant))
        }
    }
}
