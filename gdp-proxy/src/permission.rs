//! The certificate that lets a route write or read its name.

use crate::config::Side;
use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, CertError, Issued, MAX_CERT_FILE, Reading};
use gdp_util::unix_time::unix_seconds;
use gdp_wire::Name;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// What the owner of the name allows this proxy.
#[derive(Clone, PartialEq)]
pub enum Permission {
    Publish(Issued<AdCert>),
    Read(Reading),
}

impl Permission {
    /// The direction that it is for.
    pub fn side(&self) -> Side {
        match self {
            Self::Publish(_) => Side::Out,
            Self::Read(_) => Side::In,
        }
    }

    /// Of a topic that goes out.
    pub fn publish(self) -> Option<Issued<AdCert>> {
        match self {
            Self::Publish(cert) => Some(cert),
            Self::Read(_) => None,
        }
    }

    /// Of a topic that comes in.
    pub fn read(self) -> Option<Reading> {
        match self {
            Self::Publish(_) => None,
            Self::Read(grant) => Some(grant),
        }
    }
}

/// What the file with the right to one direction of a topic holds now.
pub fn load_permission(path: &Path, side: Side, card: &NameCard, entity: Name) -> Result<Permission, String> {
    let mut text = String::new();
    let file = File::open(path).map_err(|error| error.to_string())?;
    file.take(MAX_CERT_FILE as u64 + 1).read_to_string(&mut text).map_err(|error| error.to_string())?;
    check_permission(side, &text, card, entity, unix_seconds()).map_err(|error| error.to_string())
}

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
            let certified = cert.verify(&card.proof(), None, now)?.entity;
            if certified != entity {
                return Err(CertError::WrongEntity { expected: entity, got: certified });
            }
            Ok(Permission::Publish(cert))
        }
        Side::In => {
            let grant = Reading::from_pem(text)?;
            grant.verify(&card.proof(), entity, None, now)?;
            Ok(Permission::Read(grant))
        }
    }
}
