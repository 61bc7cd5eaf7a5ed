//! Errors of a node and its handles.

use std::collections::BTreeMap;

use gdp_wire::Name;

use super::link_status::LinkStatus;
use super::statement::Stated;
use gdp_core::cert::CertError;
use gdp_core::domain::DomainError;
use gdp_core::peer::MAX_LANES;
use gdp_core::secret_file::SecretFileError;
use gdp_e2e::keys::RingError;
use gdp_e2e::seal::SealError;
use gdp_link::link::LinkError;
use gdp_link::port::LinkAddr;
use gdp_link::tunnel::TunnelError;
use gdp_proto::control::{Refusal, RefusalCode};

/// Why a node could not perform an operation.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NodeError {
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error(transparent)]
    Tunnel(#[from] TunnelError),
    #[error(transparent)]
    Domain(#[from] DomainError),
    #[error("no answer from {wanted} on interface {interface}; is it running there, and is the cable plugged in?")]
    NoAnswer { interface: String, wanted: String },
    #[error("host {host} has no address: {source}; check the name, and that the network is up")]
    NoAddress { host: String, source: std::io::Error },
    #[error("who answered on the segment is not the switch that it says: {0}")]
    NoSwitch(Box<NodeError>),
    #[error("the peer at {0} is no switch")]
    NotASwitch(LinkAddr),
    #[error("refused: {0}")]
    Refused(#[from] Refusal),
    #[error(transparent)]
    Cert(#[from] CertError),
    #[error(transparent)]
    Seal(#[from] SealError),
    #[error("there is no link to the switch at the moment: {0}")]
    Detached(String),
    #[error("{name:#} is {stated} by this node already; share the handle")]
    Already { name: Name, stated: Stated },
    #[error(transparent)]
    Keys(#[from] RingError),
    #[error("no server of {0:#} is attached at the moment; call again later")]
    NoServer(Name),
    #[error("{instance:#}, a server of {service:#}, is not attached at the moment; call again later, or another")]
    NoInstance { service: Name, instance: Name },
    #[error(
        "{instance:#}, a server of {service:#}, left before it replied; the request may have been carried out, so it \
         is sent to no other"
    )]
    InstanceLeft { service: Name, instance: Name },
    #[error("{0} calls wait for their replies already; wait for some, or give some up")]
    TooManyCalls(usize),
    #[error("the switch answered another question: {0}")]
    Protocol(&'static str),
    #[error("a node has 1 to {MAX_LANES} links, not {0}")]
    Links(usize),
    #[error(transparent)]
    State(#[from] SecretFileError),
    #[error(transparent)]
    Unflushed(#[from] Unflushed),
    #[error("the node is closed")]
    Closed,
}

impl NodeError {
    /// Returns the error of a node none of whose links is up, with the reason of each.
    pub(super) fn unreachable(links: &[LinkStatus]) -> Self {
        let reason = |link: &LinkStatus| format!("{}: {}", link.target, link.reason.as_deref().unwrap_or("up"));
        Self::Detached(links.iter().map(reason).collect::<Vec<_>>().join("; "))
    }

    /// Returns whether a later attempt may succeed. Otherwise the same operation fails in the same
    /// way.
    pub fn may_pass(&self) -> bool {
        match self {
            Self::Link(LinkError::Io { .. } | LinkError::WrongPeer { .. }) => false,
            Self::Refused(refusal) => {
                matches!(refusal.code, RefusalCode::Unreachable | RefusalCode::Limit | RefusalCode::NotAttached)
            }
            Self::Link(_) | Self::Tunnel(_) | Self::NoAnswer { .. } | Self::NoAddress { .. } | Self::NoSwitch(_) => {
                true
            }
            // The credentials may be renewed.
            Self::Domain(_) => true,
            Self::Detached(_) | Self::NoServer(_) | Self::NoInstance { .. } | Self::InstanceLeft { .. } => true,
            Self::TooManyCalls(_) | Self::Unflushed(_) => true,
            Self::NotASwitch(_) | Self::Cert(_) | Self::Seal(_) | Self::Already { .. } | Self::Keys(_) => false,
            Self::Protocol(_) | Self::Links(_) | Self::State(_) | Self::Closed => false,
        }
    }
}

/// The messages that a flush did not finish in time: see
/// [`Publisher::flush`](super::Publisher::flush).
#[derive(Clone, Debug, Default, PartialEq, Eq, thiserror::Error)]
#[error("{unsent} messages have not gone in time, and {} readers have not acknowledged all that \
         have", unacknowledged.len())]
pub struct Unflushed {
    /// Messages that have not left this host.
    pub unsent: u64,
    /// Live readers of a reliable name, with the number of messages that each has not acknowledged.
    pub unacknowledged: BTreeMap<Name, u64>,
}

#[cfg(test)]
#[path = "../../tests/unit/node/error.rs"]
mod tests;
