//! What the ledger beside a domain's card remembers of each certificate.

use std::path::PathBuf;

use gdp_core::cert::{Claims, Invite, MemberCert, PeerCert, PeerRights, Revocation};
use gdp_wire::Name;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::super::issuance_log;

/// One certificate of the domain.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Issue {
    pub serial: u64,
    pub to: To,
    pub not_before: u64,
    pub not_after: u64,
    /// When all that rests on it has ended.
    pub ends: u64,
    /// None for an invitation: it is nowhere but with whom it was given to.
    pub file: Option<PathBuf>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum To {
    Member { entity: Name, role: String },
    Invited { role: String },
    Peer { domain: Name, rights: PeerRights },
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

    /// The entity or domain that it is for.
    pub fn holder(&self) -> Option<Name> {
        match self.to {
            To::Member { entity, .. } => Some(entity),
            To::Peer { domain, .. } => Some(domain),
            To::Invited { .. } => None,
        }
    }

    pub fn right(&self) -> String {
        match &self.to {
            To::Member { role, .. } | To::Invited { role } => role.clone(),
            To::Peer { rights, .. } => rights.to_string(),
        }
    }

    pub fn state(&self, revocation: Option<&Revocation>, now: u64) -> &'static str {
        match revocation.map(|revocation| revocation.check(self.kind(), self.serial)) {
            Some(Err(_)) => "revoked",
            _ if now > self.not_after => "expired",
            _ if now < self.not_before => "not yet",
            _ => "valid",
        }
    }

    pub fn describe(&self, state: &str) -> Value {
        json!({
            // JavaScript and jq do not count that far.
            "serial": self.serial.to_string(),
            "kind": self.kind(), "to": self.to, "not_before": self.not_before, "not_after": self.not_after,
            "file": self.file, "state": state,
        })
    }
}
