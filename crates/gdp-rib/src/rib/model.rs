//! The keys, moments and limits that all parts of the RIB share.

use gdp_proto::control::PeersPush;

use crate::rib::journal::Item;
use gdp_proto::control::{NameRole, RecordKey};
use gdp_wire::Name;

use gdp_core::cert::CertError;
use gdp_proto::control::{Refusal, RefusalCode};
use std::collections::HashMap;
use std::hash::Hash;

use std::time::Duration;

/// A moment, on both clocks that matter.
#[derive(Clone, Copy, Debug)]
pub struct Now {
    /// Unix seconds: certificates are judged by it.
    pub unix: u64,
    /// Since any fixed moment; never goes back. Everything that lasts is counted on it.
    pub clock: Duration,
}

impl Now {
    /// When something is over that holds until the end of this Unix second.
    pub fn clock_at(&self, unix: u64) -> Duration {
        self.clock + Duration::from_secs(unix.saturating_sub(self.unix).saturating_add(1).min(u32::MAX.into()))
    }
}

/// What a RIB holds at most.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    pub names: usize,
    pub names_per_entity: usize,
    pub attached_per_switch: usize,
    /// Entities that only tools speak for, through one switch.
    pub unattached_per_switch: usize,
    /// Publishers or servers of one name.
    pub writers_per_name: usize,
    /// Subscribers or callers of one name at one switch.
    pub readers_per_switch: usize,
    /// Entities that one entity exchanges messages with.
    pub counterparts: usize,
    /// The same for all entities at a switch: as many pairs of names and links does its data plane
    /// hold for them.
    pub counterparts_per_switch: usize,
    /// Readers that one writer has key boxes for, of one name and epoch.
    pub box_readers: usize,
    pub boxes_per_entity: usize,
    /// Of all entities at a switch.
    pub boxes_per_switch: usize,
    /// Revocations of names that somebody has a part in, and that came in by one origin; more count
    /// as the following.
    pub used_revocations: usize,
    /// Revocations of names that nobody has a part in.
    pub idle_revocations: usize,
    /// Records that one neighbouring domain tells of.
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

/// The refusal that tells a requester of a certificate error.
pub fn refusal(error: CertError) -> Refusal {
    let code = match &error {
        CertError::BadSignature { .. } | CertError::WrongKey { .. } => RefusalCode::BadSignature,
        CertError::NotYetValid { .. } => RefusalCode::NotYetValid,
        CertError::Expired { .. } => RefusalCode::Expired,
        CertError::WrongName { .. } => RefusalCode::WrongName,
        CertError::WrongEntity { .. } => RefusalCode::WrongEntity,
        CertError::WrongSwitch { .. } => RefusalCode::WrongSwitch,
        CertError::ReplayedSerial { .. } | CertError::RolledBack { .. } => RefusalCode::ReplayedSerial,
        CertError::Revoked { .. } => RefusalCode::Revoked,
        CertError::NotDelegated { .. }
        | CertError::BeforeDelegation { .. }
        | CertError::NotAMember { .. }
        | CertError::ByInvitation { .. }
        | CertError::WrongRole { .. }
        | CertError::WrongDomain { .. } => RefusalCode::NotEntitled,
        CertError::Malformed(_) | CertError::WrongOperation { .. } | CertError::Crypto(_) => RefusalCode::Malformed,
    };
    Refusal::new(code, error.to_string())
}

/// A name by which maps are ordered as its hex digits are.
pub type NameBytes = [u8; 32];

/// What one entity is to one name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct RegistrationKey {
    pub name: NameBytes,
    pub entity: Name,
    pub role: NameRole,
}

impl RegistrationKey {
    /// What an entity is to its own name: it takes what its counterparts send there. Of this it is
    /// told nothing but who has keys for it.
    pub fn inbox(entity: Name) -> Self {
        Self { name: entity.to_bytes(), entity, role: NameRole::Subscriber }
    }

    /// As it is stored, of what is stated at `switch`.
    pub fn at(&self, switch: Name) -> Item {
        let (name, entity, role) = (Name::from_bytes(self.name), self.entity, self.role);
        Item::Registration(RecordKey { name, role, entity, switch })
    }

    pub fn is_inbox(&self) -> bool {
        self.name == self.entity.to_bytes()
    }
}

/// Which [`PeersPush`] it was.
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

/// The entities of one domain that one neighbouring domain told of. All are reached by the same
/// ways.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Realm {
    pub next: Name,
    pub domain: Name,
}

/// Where an entity is, as seen from here.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum At {
    /// At a switch of this domain.
    Here(Name),
    RemoteRegistrations(Realm),
}

/// An attached entity, and where it is attached.
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
