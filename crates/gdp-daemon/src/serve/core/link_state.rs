//! The state of a link that is up, with its data-plane entry.

use std::time::{Duration, Instant};

use gdp_core::peer::Role;
use gdp_link::link::{KeyedEntry, Link};
use gdp_link::port::LinkAddr;
use gdp_proto::admin::words::PeerRole;
use gdp_rib::crossing::Allowance;
use gdp_wire::{LinkEntry, LinkRole, Name};

use crate::config::Via;
use crate::domain::{Admission, Relationship};

/// Questions of an endpoint that are answered at once, such as the probes of one trace.
const BURST: u32 = 64;

/// Time in which the allowance for one more question refills.
const INTERVAL: Duration = Duration::from_millis(50);

/// Returns the allowance for the questions of an endpoint about its attachment and its names.
pub fn inspections() -> Allowance {
    Allowance::new(BURST, INTERVAL)
}

/// The state of a link that is up.
pub struct LinkState {
    pub link: Link,
    pub via: Via,
    pub since: Instant,
    /// The peer's relationship to this switch's domain, and its expiry.
    pub admission: Admission,
    /// The rate limit on traces that the peer requests, if it is of another domain.
    pub traces: Allowance,
    /// The rate limit on questions of the peer, if it is an endpoint.
    pub inspections: Allowance,
    pub entry: KeyedEntry,
    pub to: LinkAddr,
    /// Whether the data plane at the other end answers echoes, as far as it is asked.
    pub answers: bool,
}

impl LinkState {
    /// Returns the peer's role in the data planes, as a [`LinkRole`] value.
    pub fn role(&self) -> u32 {
        self.entry.role
    }

    /// Returns the peer's domain, if the peer is a border of another domain.
    pub fn domain(&self) -> Option<Name> {
        match self.admission.relationship {
            Relationship::Border { domain, .. } => Some(domain),
            _ => None,
        }
    }
}

/// Returns the role that the data planes give the peer of a link.
pub fn role_on(link: &Link, admission: &Admission) -> LinkRole {
    match link.peer().role {
        _ if admission.relationship.is_border() => LinkRole::Border,
        Role::Endpoint => LinkRole::Endpoint,
        Role::Switch => LinkRole::Switch,
    }
}

/// Returns the flags of a link's data-plane entry: whether the peer's domain has transit.
pub fn flags_of(admission: &Admission) -> u16 {
    match &admission.relationship {
        Relationship::Border { ours, .. } if ours.transit => LinkEntry::TRANSIT,
        _ => 0,
    }
}

/// Returns the name of a role in the data planes. Unknown values count as a switch.
pub fn link_role(role: u32) -> PeerRole {
    match role {
        _ if role == LinkRole::Endpoint as u32 => PeerRole::Endpoint,
        _ if role == LinkRole::Border as u32 => PeerRole::Border,
        _ => PeerRole::Switch,
    }
}
