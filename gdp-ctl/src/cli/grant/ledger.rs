//! Entries of the ledger beside a name card, one for each grant.

use std::fmt;
use std::path::PathBuf;

use gdp_core::cert::{AdCert, Claims, Delegation, Grantee, ReadGrant, Revocation};
use gdp_core::identity::VerifyKey;
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::issuance_log;

/// A certificate in the ledger.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Grant {
    pub serial: u64,
    /// May publish or serve. A delegate may grant this to others.
    pub publish: bool,
    /// May subscribe or call. A delegate may grant this to others.
    pub read: bool,
    pub to: Holder,
    pub not_before: u64,
    pub not_after: u64,
    pub file: PathBuf,
}

impl issuance_log::Entry for Grant {
    const SUFFIX: &'static str = ".grants";

    fn serial(&self) -> u64 {
        self.serial
    }

    fn ends(&self) -> u64 {
        self.not_after
    }
}

impl Grant {
    /// Returns `valid`, `not yet`, `expired` or `revoked`.
    pub fn state(&self, revocation: Option<&Revocation>, now: u64) -> &'static str {
        let kind = match self.to {
            Holder::Delegate(_) => Delegation::KIND,
            _ if self.publish => AdCert::KIND,
            _ => ReadGrant::KIND,
        };
        match revocation.map(|revocation| revocation.check(kind, self.serial)) {
            Some(Err(_)) => "revoked",
            _ if now > self.not_after => "expired",
            _ if now < self.not_before => "not yet",
            _ => "valid",
        }
    }
}

/// The recipient of a certificate.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum Holder {
    Entity(Name),
    Role { domain: Name, role: String },
    Delegate(#[schemars(with = "String")] VerifyKey),
}

impl From<Grantee> for Holder {
    fn from(grantee: Grantee) -> Self {
        match grantee {
            Grantee::Entity(entity) => Self::Entity(entity),
            Grantee::Role { domain, role } => Self::Role { domain, role },
        }
    }
}

impl Holder {
    /// Returns the entity, unless the recipient is a role or a delegate.
    pub fn entity(&self) -> Option<Name> {
        match self {
            Self::Entity(entity) => Some(*entity),
            Self::Role { .. } | Self::Delegate(_) => None,
        }
    }
}

impl fmt::Display for Holder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Entity(entity) => write!(f, "{entity}"),
            Self::Role { domain, role } => write!(f, "role {role} of {domain}"),
            Self::Delegate(key) => write!(f, "delegate {key}"),
        }
    }
}
