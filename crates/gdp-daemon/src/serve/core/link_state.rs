//! A link that is up, and what the data planes hold of its peer.

use std::time::Instant;

use gdp_core::peer::Role;
use gdp_link::link::{KeyedEntry, Link};
use gdp_link::port::LinkAddr;
use gdp_proto::admin::words::PeerRole;
use gdp_rib::crossing::Allowance;
use gdp_wire::{LinkEntry, LinkRole, Name};

use crate::config::Via;
use crate::domain::{Admission, Relationship};

/// A link that is up.
pub struct LinkState {
    pub link: Link,
    pub via: Via,
    pub since: Instant,
    /// What the peer is to this switch's domain, and until when.
    pub admission: Admission,
    /// Traces that the other end asks for, if it is of another domain.
    pub traces: Allowance,
    pub entry: KeyedEntry,
    pub to: LinkAddr,
}

impl LinkState {
    /// What the data planes hold the peer for.
    pub fn role(&self) -> u32 {
        self.entry.role
    }

    /// The domain whose border is at the other end.
    pub fn domain(&self) -> Option<Name> {
        match self.admission.standing {
            Relationship::Border { domain, .. } => Some(domain),
            _ => None,
        }
    }
}

/// What the data planes take the peer of a link for.
pub fn role_on(link: &Link, admission: &Admission) -> LinkRole {
    match link.peer().role {
        _ if admission.standing.is_border() => LinkRole::Border,
        Role::Endpoint => LinkRole::Endpoint,
        Role::Switch => LinkRole::Switch,
    }
}

/// What the entry of a link says of the peer's domain.
pub fn flags_of(admission: &Admission) -> u16 {
    match &admission.standing {
        Relationship::Border { ours, .. } if ours.transit => LinkEntry::TRANSIT,
        _ => 0,
    }
}

/// As the data planes know a peer.
pub fn link_role(role: u32) -> PeerRole {
    match role {
        _ if role == LinkRole::Endpoint as u32 => PeerRole::Endpoint,
        _ if role == LinkRole::Border as u32 => PeerRole::Border,
        _ => PeerRole::Switch,
    }
}
