//! Entries of the ledger beside a domain's card, one for each certificate.

use std::collections::BTreeMap;
use std::path::PathBuf;

use gdp_core::cert::{Claims, Invite, MemberCert, PeerCert, PeerRights, Revocation};
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::super::issuance_log;

/// One certificate of the domain.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Issue {
    pub serial: u64,
    pub to: To,
    /// Label of the member in the domain's directory.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<String>,
    pub not_before: u64,
    pub not_after: u64,
    /// Time at which the certificate and all that depend on it have expired.
    pub ends: u64,
    /// `None` for an invitation, which only its recipient has.
    pub file: Option<PathBuf>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum To {
    Member {
        entity: Name,
        role: String,
    },
    Invited {
        role: String,
    },
    Peer {
        domain: Name,
        #[schemars(with = "BTreeMap<String, bool>")]
        rights: PeerRights,
    },
}

impl issuance_log::Entry for Issue {
    const SUFFIX: &'static str = ".members";

    fn serial(&self) -> u64 {
        self.serial
    }

    fn ends(&self) -> u64 {
        self.ends
    }
}

impl Issue {
    pub fn kind(&self) -> &'static str {
        match self.to {
            To::Member { .. } => MemberCert::KIND,
            To::Invited { .. } => Invite::KIND,
            To::Peer { .. } => PeerCert::KIND,
        }
    }

    /// Returns the entity or domain to which the certificate was issued.
    pub fn holder(&self) -> Option<Name> {
        self.member().or(self.peer())
    }

    /// Returns the entity that the certificate makes a member.
    pub fn member(&self) -> Option<Name> {
        match self.to {
            To::Member { entity, .. } => Some(entity),
            To::Peer { .. } | To::Invited { .. } => None,
        }
    }

    /// Returns the domain to which the certificate grants rights.
    pub fn peer(&self) -> Option<Name> {
        match self.to {
            To::Peer { domain, .. } => Some(domain),
            To::Member { .. } | To::Invited { .. } => None,
        }
    }

    pub fn right(&self) -> String {
        match &self.to {
            To::Member { role, .. } | To::Invited { role } => role.clone(),
            To::Peer { rights, .. } => rights.to_string(),
        }
    }

    pub fn is_revoked(&self, revocation: Option<&Revocation>) -> bool {
        revocation.is_some_and(|revocation| revocation.check(self.kind(), self.serial).is_err())
    }

    pub fn state(&self, revocation: Option<&Revocation>, now: u64) -> &'static str {
        match self.not_after {
            _ if self.is_revoked(revocation) => "revoked",
            not_after if now > not_after => "expired",
            _ if now < self.not_before => "not yet",
            _ => "valid",
        }
    }

    pub fn describe(&self, state: &'static str) -> IssueOutput {
        let Self { serial, to, label, not_before, not_after, file, .. } = self.clone();
        IssueOutput { serial: serial.to_string(), kind: self.kind(), to, label, not_before, not_after, file, state }
    }
}

/// A certificate of the domain in the output of `gdp-ctl domain show`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct IssueOutput {
    /// As text, because JavaScript and jq round such numbers.
    serial: String,
    kind: &'static str,
    to: To,
    /// Label of the member in the domain's directory.
    label: Option<String>,
    not_before: u64,
    not_after: u64,
    /// None for an invitation.
    file: Option<PathBuf>,
    /// `valid`, `not yet`, `expired` or `revoked`.
    state: &'static str,
}
