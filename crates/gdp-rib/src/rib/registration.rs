//! Registration of one entity for a name, at one switch.

use crate::rib::model::{At, Realm};
use gdp_core::cert::{Advert, Revocation, Signed};
use gdp_core::name::NameProof;
use gdp_proto::control::{Credential, NameRole, Record};
use gdp_wire::Name;
use std::sync::Arc;
use std::time::Duration;

/// Bytes of an encoded record besides credential and statement: two proofs, two names, field names.
pub const RECORD_OVERHEAD: usize = 512;

/// Registration of one entity for a name, at one switch.
#[derive(Clone, Debug)]
pub struct Registration {
    pub by: Arc<EntityIdentity>,
    /// Switch at which the entity registered. It belongs to another domain if the registration is
    /// remote.
    pub switch: Name,
    pub remote: Option<Box<Remote>>,
    pub role: NameRole,
    pub credential: Credential,
    pub advert: Signed<Advert>,
    /// Serial of the statement.
    pub serial: u64,
    /// Other domains that may know the registration. Always empty for readers and callers.
    pub scope: Arc<[Name]>,
    /// The entity's registrations at other switches stay valid beside this one. The entity sends
    /// this statement on each of its links.
    pub everywhere: bool,
    pub ends: Duration,
    /// The registration ends with the attachment of its entity. A bound entity receives updates
    /// about its counterparts and can be reached by them. A remote entity can be reached, but its
    /// own RIB updates it.
    pub bound: bool,
    /// Generation of the updates that the entity holds through this switch while none are pending.
    /// No [stream](super::peer_updates) is stored then. 0 if a stream exists or another switch is
    /// used.
    pub sent_update: u64,
}

/// Identity that an entity presents in its statements. Most of them share one.
#[derive(Debug, PartialEq, Eq)]
pub struct EntityIdentity {
    pub name: Name,
    pub proof: NameProof,
    pub box_key: [u8; 33],
}

/// Shares a scope. An empty scope, the usual case, needs no allocation.
pub fn shared(scope: Vec<Name>) -> Arc<[Name]> {
    if scope.is_empty() { Arc::default() } else { scope.into() }
}

/// Properties of a registration that another RIB announced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Remote {
    pub realm: Realm,
    /// Same as in [`super::Foreign`].
    pub hops: u32,
    pub local: bool,
}

/// Properties of a registration that determine its counterparts.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct EndpointScope {
    pub realm: Option<Realm>,
    /// Entities of this domain may know the registration.
    pub local: bool,
    pub scope: Arc<[Name]>,
}

impl EndpointScope {
    /// Returns whether a writer of this kind and a reader of kind `other` are counterparts here.
    ///
    /// The writer's scope must cover the reader, and their messages must pass through this domain.
    pub fn meets(&self, other: &Self) -> bool {
        match (self.realm, other.realm) {
            (None, None) => true,
            (Some(_), None) => self.local,
            (None, Some(realm)) => other.local && self.scope.contains(&realm.domain),
            (Some(from), Some(to)) => {
                from.domain != to.domain && from.next != to.next && self.scope.contains(&to.domain)
            }
        }
    }
}

impl Registration {
    pub fn at(&self) -> At {
        self.remote.as_ref().map_or(At::Here(self.switch), |remote| At::RemoteRegistrations(remote.realm))
    }

    /// Returns whether the entity is in this domain.
    pub fn is_here(&self) -> bool {
        self.remote.is_none()
    }

    /// Returns the entity and the switch, which order the registrations.
    pub fn entity_and_switch(&self) -> (Name, Name) {
        (self.by.name, self.switch)
    }

    /// Returns whether no certificate in the credential is revoked.
    pub fn stands_after(&self, revocation: &Revocation) -> bool {
        let check = |(what, serial): (_, u64)| revocation.check(what, serial).is_ok();
        self.credential.serials().is_ok_and(|serials| serials.into_iter().all(check))
    }

    pub fn kind(&self) -> EndpointScope {
        let (realm, local) = self.remote.as_ref().map_or((None, true), |remote| (Some(remote.realm), remote.local));
        EndpointScope { realm, local, scope: self.scope.clone() }
    }

    /// Returns whether the entities of two registrations with opposite roles exchange messages.
    pub fn meets(&self, other: &Self) -> bool {
        meets(self.role, &self.kind(), &other.kind())
    }

    pub fn size(&self) -> usize {
        RECORD_OVERHEAD + self.credential.size() + self.advert.as_bytes().len()
    }

    pub fn record(&self, now: Duration, name: Name, proof: NameProof) -> Record {
        Record {
            name,
            proof,
            entity: self.by.proof,
            switch: self.switch,
            credential: self.credential.clone(),
            advert: self.advert.clone(),
            expires_in: self.ends.saturating_sub(now).as_secs(),
        }
    }

    /// Returns whether a counterpart that knows `other` needs no update about this registration.
    /// Callers of a service also need to know the switches of its servers.
    pub fn tells_the_same(&self, other: &Self) -> bool {
        let is_as_near = self.role != NameRole::Server || self.switch == other.switch;
        self.credential == other.credential
            && self.by.box_key == other.by.box_key
            && self.kind() == other.kind()
            && is_as_near
    }
}

/// Returns whether an entity of this role and kind exchanges messages with one of the opposite role
/// and kind `other`.
pub fn meets(role: NameRole, kind: &EndpointScope, other: &EndpointScope) -> bool {
    if role.is_writer() { kind.meets(other) } else { other.meets(kind) }
}

/// Verified statement with its credential and derived limits.
pub struct Verified {
    pub name: NameProof,
    pub credential: Credential,
    pub signed: Signed<Advert>,
    pub advert: Advert,
    pub everywhere: bool,
    pub scope: Vec<Name>,
    pub not_after: u64,
}
