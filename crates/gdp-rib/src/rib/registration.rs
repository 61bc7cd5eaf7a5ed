//! One entity's part in a name, at one switch.

use crate::rib::model::{At, Realm};
use gdp_core::cert::{Advert, Revocation, Signed};
use gdp_core::name::NameProof;
use gdp_proto::control::{Credential, NameRole, Record};
use gdp_wire::Name;
use std::sync::Arc;
use std::time::Duration;

/// What an encoded record has besides credential and statement: two proofs, two names, field names.
pub const RECORD_OVERHEAD: usize = 512;

/// One entity's part in a name, at one switch.
#[derive(Clone, Debug)]
pub struct Registration {
    pub by: Arc<EntityIdentity>,
    /// Of another domain, if the entity is abroad.
    pub switch: Name,
    pub remote: Option<Box<Remote>>,
    pub role: NameRole,
    pub credential: Credential,
    pub advert: Signed<Advert>,
    /// Of the statement.
    pub serial: u64,
    /// Domains besides the one that it is stated in, that may know it; of those that read or call
    /// always empty.
    pub scope: Arc<[Name]>,
    /// What is stated at other switches stands besides; and this one sends it on each link of the
    /// entity.
    pub everywhere: bool,
    pub ends: Duration,
    /// Ends with the attachment of its entity; the entity is told of its counterparts, and can be
    /// reached by them. One from abroad can be reached; what it is told is for the RIB there.
    pub bound: bool,
    /// The generation that the entity holds of what it is told of the name through this switch,
    /// while there is nothing more to tell: no [stream](super::peer_updates) is kept for it then.
    /// 0: there is one, or it is told elsewhere.
    pub sent_update: u64,
}

/// An entity, as it shows itself in its statements: most of them share one.
#[derive(Debug, PartialEq, Eq)]
pub struct EntityIdentity {
    pub name: Name,
    pub proof: NameProof,
    pub box_key: [u8; 33],
}

/// Nothing is allocated for an empty scope, as most are.
pub fn shared(scope: Vec<Name>) -> Arc<[Name]> {
    if scope.is_empty() { Arc::default() } else { scope.into() }
}

/// What is known of a registration besides, if another RIB told of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Remote {
    pub realm: Realm,
    /// As in [`super::Foreign`].
    pub hops: u32,
    pub local: bool,
}

/// All about a registration that says with whom it may exchange messages.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Kind {
    pub realm: Option<Realm>,
    /// Entities of this domain may know it.
    pub local: bool,
    pub scope: Arc<[Name]>,
}

impl Kind {
    /// Whether a writer of this kind and a reader of `other` kind are counterparts here: as far as
    /// the writer's scope goes, and not if their messages reach each other without passing here.
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

    /// Whether the entity is in this domain.
    pub fn is_here(&self) -> bool {
        self.remote.is_none()
    }

    /// By entity and switch.
    pub fn entity_and_switch(&self) -> (Name, Name) {
        (self.by.name, self.switch)
    }

    /// Whether all certificates in its credential still count.
    pub fn stands_after(&self, revocation: &Revocation) -> bool {
        let check = |(what, serial): (_, u64)| revocation.check(what, serial).is_ok();
        self.credential.serials().is_ok_and(|serials| serials.into_iter().all(check))
    }

    pub fn kind(&self) -> Kind {
        let (realm, local) = self.remote.as_ref().map_or((None, true), |remote| (Some(remote.realm), remote.local));
        Kind { realm, local, scope: self.scope.clone() }
    }

    /// Whether two with opposite roles exchange messages.
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

    /// Whether a counterpart that knows `other` need not be told of this one. Who calls a service
    /// wants to know where its servers are.
    pub fn tells_the_same(&self, other: &Self) -> bool {
        let is_as_near = self.role != NameRole::Server || self.switch == other.switch;
        self.credential == other.credential
            && self.by.box_key == other.by.box_key
            && self.kind() == other.kind()
            && is_as_near
    }
}

/// Whether one of this role and kind exchanges messages with one of the opposite role and kind
/// `other`.
pub fn meets(role: NameRole, kind: &Kind, other: &Kind) -> bool {
    if role.is_writer() { kind.meets(other) } else { other.meets(kind) }
}

/// A statement that is verified, with what it rests on.
pub struct Verified {
    pub name: NameProof,
    pub credential: Credential,
    pub signed: Signed<Advert>,
    pub advert: Advert,
    pub everywhere: bool,
    pub scope: Vec<Name>,
    pub not_after: u64,
}
