//! Keys, times and limits that all parts of the RIB share.

use gdp_proto::control::PeersPush;

use crate::rib::journal::Item;
use gdp_proto::control::{NameRole, RecordKey};
use gdp_wire::Name;

use gdp_core::cert::CertError;
use gdp_proto::control::{Refusal, RefusalCode};
use std::collections::HashMap;
use std::hash::Hash;

use std::time::Duration;

/// Current time on both clocks.
#[derive(Clone, Copy, Debug)]
pub struct Now {
    /// Unix time in seconds, for the validity of certificates.
    pub unix: u64,
    /// Monotonic time since an arbitrary moment, for all durations.
    pub clock: Duration,
}

impl Now {
    /// Returns the monotonic time at which the Unix second `unix` has ended.
    pub fn clock_at(&self, unix: u64) -> Duration {
        self.clock + Duration::from_secs(unix.saturating_sub(self.unix).saturating_add(1).min(u32::MAX.into()))
    }
}

/// Limits on the state of a RIB.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    pub names: usize,
    pub names_per_entity: usize,
    pub attached_per_switch: usize,
    /// Entities without an attachment, known through one switch by tools only.
    pub unattached_per_switch: usize,
    /// Publishers or servers of one name.
    pub writers_per_name: usize,
    /// Subscribers or callers of one name at one switch.
    pub readers_per_switch: usize,
    /// Entities that one entity exchanges messages with.
    pub counterparts: usize,
    /// Pairs of counterparts for all entities at one switch. The switch's data plane holds as many
    /// pairs of names and links for them.
    pub counterparts_per_switch: usize,
    /// Readers for which one writer has key boxes, per name and epoch.
    pub box_readers: usize,
    pub boxes_per_entity: usize,
    /// Key boxes of all entities at one switch.
    pub boxes_per_switch: usize,
    /// Revocations of registered names from one origin. Further ones count as idle.
    pub used_revocations: usize,
    /// Revocations of names without a registration.
    pub idle_revocations: usize,
    /// Records announced by one neighbouring domain.
    pub records_per_neighbour: usize,
    /// Links into one domain.
    pub ways_per_domain: usize,
}

impl Default for Limits {
    fn default() -> Self {
        let links = gdp_wire::table::MAX_LINKS as usize;
        Self {
            names: 1 << 20,
            names_per_entity: 16_384,
            attached_per_switch: links,
            unattached_per_switch: 4096,
            writers_per_name: 256,
            readers_per_switch: links,
            counterparts: 4096,
            counterparts_per_switch: 65_536,
            box_readers: 1024,
            boxes_per_entity: 8192,
            boxes_per_switch: 65_536,
            used_revocations: 4096,
            idle_revocations: 16_384,
            records_per_neighbour: 65_536,
            ways_per_domain: 16,
        }
    }
}

pub fn count_out<K: Eq + Hash>(counts: &mut HashMap<K, usize>, key: &K, count: usize) {
    if let Some(held) = counts.get_mut(key) {
        *held -= count;
        if *held == 0 {
            counts.remove(key);
        }
    }
}

pub fn limit_reached(what: String) -> Refusal {
    Refusal::new(RefusalCode::Limit, format!("{what}, and that is the limit of this RIB"))
}

/// Converts a certificate error into a refusal for the requester.
pub fn refusal(error: CertError) -> Refusal {
    let code = match &error {
        CertError::BadSignature { .. } | CertError::HighS { .. } | CertError::WrongKey { .. } => {
            RefusalCode::BadSignature
        }
        CertError::NotYetValid { .. } | CertError::IssuedLater { .. } => RefusalCode::NotYetValid,
        CertError::Expired { .. } => RefusalCode::Expired,
        CertError::WrongName { .. } => RefusalCode::WrongName,
        CertError::WrongEntity { .. } => RefusalCode::WrongEntity,
        CertError::WrongSwitch { .. } => RefusalCode::WrongSwitch,
        CertError::ReplayedSerial { .. } | CertError::RolledBack { .. } => RefusalCode::ReplayedSerial,
        CertError::Revoked { .. } | CertError::Retired { .. } => RefusalCode::Revoked,
        CertError::NotDelegated { .. }
        | CertError::BeforeDelegation { .. }
        | CertError::NotAMember { .. }
        | CertError::ByInvitation { .. }
        | CertError::WrongRole { .. }
        | CertError::WrongDomain { .. }
        | CertError::NotADomain { .. } => RefusalCode::NotEntitled,
        CertError::OldVersion { .. } | CertError::UnknownField { .. } => RefusalCode::Unsupported,
        CertError::Malformed(_) | CertError::WrongOperation { .. } | CertError::Crypto(_) => RefusalCode::Malformed,
    };
    Refusal::new(code, error.to_string())
}

/// Name as bytes, which orders maps like the hex digits of the name.
pub type NameBytes = [u8; 32];

/// Name, entity and role of a registration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct RegistrationKey {
    pub name: NameBytes,
    pub entity: Name,
    pub role: NameRole,
}

impl RegistrationKey {
    /// Returns the key of the entity's inbox, the registration for its own name. The only updates
    /// about it list the writers with key boxes for it.
    pub fn inbox(entity: Name) -> Self {
        Self { name: entity.to_bytes(), entity, role: NameRole::Subscriber }
    }

    /// Returns the store item of this registration at `switch`.
    pub fn at(&self, switch: Name) -> Item {
        let (name, entity, role) = (Name::from_bytes(self.name), self.entity, self.role);
        Item::Registration(RecordKey { name, role, entity, switch })
    }

    pub fn is_inbox(&self) -> bool {
        self.name == self.entity.to_bytes()
    }
}

/// Identifies a [`PeersPush`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UpdateId {
    pub switch: Name,
    pub registration_key: RegistrationKey,
    pub generation: u64,
}

impl From<&PeersPush> for UpdateId {
    fn from(push: &PeersPush) -> Self {
        let registration_key = RegistrationKey { name: push.name.to_bytes(), entity: push.entity, role: push.role };
        Self { switch: push.switch, registration_key, generation: push.peers.generation }
    }
}

/// Entities of one domain that one neighbouring domain announced. The same links lead to all of
/// them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Realm {
    pub next: Name,
    pub domain: Name,
}

/// Location of an entity, as seen from this domain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum At {
    /// At a switch of this domain.
    Here(Name),
    RemoteRegistrations(Realm),
}

/// Attached entity and its location.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InboxOwner {
    pub entity: Name,
    pub at: At,
}

pub fn lifetime(now: Now, stated: u32, not_after: u64) -> Result<Duration, Refusal> {
    if stated == 0 {
        return Err(Refusal::new(RefusalCode::Malformed, "a statement with a lifetime of 0 s states nothing"));
    }
    let seconds = u64::from(stated).min((not_after - now.unix).max(1));
    Ok(now.clock.saturating_add(Duration::from_secs(seconds)))
}
