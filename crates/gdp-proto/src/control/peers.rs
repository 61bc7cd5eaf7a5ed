//! What the RIB tells an entity of those on the other side of a name: types only. [`crate::peers`]
//! receives them.

pub use crate::control::role::NameRole;

use gdp_wire::Name;
use serde::{Deserialize, Serialize};

use crate::control::record::Record;
use gdp_core::cert::{Revocation, Signed};
use gdp_core::keys::KeyBox;

/// Those on the other side of a name, all of them or what changed; to be verified by the entity
/// that is told.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Peers {
    /// Which run of a RIB this is, as in a [`FibPush`](super::FibPush).
    pub run: u64,
    /// The RIB has started so recently that it may not know all there are: whom a whole does not
    /// name is not gone for that. Another whole follows.
    pub settling: bool,
    /// Rises with everything that this RIB tells anybody.
    pub generation: u64,
    pub extent: PeersExtent,
    /// In the order of the names of their entities.
    pub records: Vec<Record>,
    /// Entities that are counterparts no more.
    pub gone: Vec<Name>,
    /// The newest of the name, with part 0 of the whole and when it changed.
    pub revocation: Option<Signed<Revocation>>,
    /// From counterparts to the entity that is told: the keys of what they send to the name, and to
    /// the entity itself.
    pub boxes: Vec<Signed<KeyBox>>,
}

/// How a message relates to what the entity was told before.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum PeersExtent {
    /// Changes what the message of this generation left. An entity that holds another one refuses,
    /// and is told the whole.
    After(u64),
    /// Part of the whole: what it does not name up to the last part is gone. The answer to a
    /// statement is part 0.
    Whole { part: u32, last: bool },
}

/// RIB → entity, relayed down. The RIB sends the next one about the same name once this is
/// answered.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PeersPush {
    /// Switches on the way pass the push on to this one, and this one to `entity`.
    pub switch: Name,
    pub entity: Name,
    pub name: Name,
    /// What `entity` is to the name: the records are of its counterparts.
    pub role: NameRole,
    pub peers: Peers,
}
