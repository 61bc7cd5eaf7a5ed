//! Role of an entity for a name.

use gdp_core::cert::AdvertOp;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Role of an entity for a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NameRole {
    Publisher,
    Server,
    Subscriber,
    Caller,
}

impl NameRole {
    pub const ALL: [Self; 4] = [Self::Publisher, Self::Server, Self::Subscriber, Self::Caller];

    /// Returns the role that a statement of this operation gives its entity; `None` for a
    /// withdrawal.
    pub fn of(op: AdvertOp) -> Option<Self> {
        match op {
            AdvertOp::Publish => Some(Self::Publisher),
            AdvertOp::Serve => Some(Self::Server),
            AdvertOp::Subscribe => Some(Self::Subscriber),
            AdvertOp::Call => Some(Self::Caller),
            AdvertOp::Withdraw => None,
        }
    }

    /// Returns the operation that gives an entity this role.
    pub fn op(self) -> AdvertOp {
        match self {
            Self::Publisher => AdvertOp::Publish,
            Self::Server => AdvertOp::Serve,
            Self::Subscriber => AdvertOp::Subscribe,
            Self::Caller => AdvertOp::Call,
        }
    }

    /// Returns the role of the counterparts.
    pub fn counterpart(self) -> Self {
        match self {
            Self::Publisher => Self::Subscriber,
            Self::Subscriber => Self::Publisher,
            Self::Server => Self::Caller,
            Self::Caller => Self::Server,
        }
    }

    /// Returns whether the role needs an AdCert; the others need a ReadGrant.
    pub fn is_writer(self) -> bool {
        matches!(self, Self::Publisher | Self::Server)
    }

    /// Returns whether the role belongs to a service. Nothing is sent to the name of a service:
    /// callers and servers send to each other's inboxes.
    pub fn is_of_service(self) -> bool {
        matches!(self, Self::Server | Self::Caller)
    }
}

impl fmt::Display for NameRole {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Publisher => "publisher",
            Self::Server => "server",
            Self::Subscriber => "subscriber",
            Self::Caller => "caller",
        })
    }
}
