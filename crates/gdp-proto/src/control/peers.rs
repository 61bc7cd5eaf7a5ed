//! Updates of the RIB to an entity about its counterparts for a name: types only. [`crate::peers`]
//! receives them.

pub use crate::control::role::NameRole;

use gdp_wire::Name;
use serde::{Deserialize, Serialize};

use crate::control::record::Record;
use gdp_core::cert::{Revocation, Signed};
use gdp_core::keys::KeyBox;

/// Counterparts for a name, all of them or changes. The receiving entity verifies them.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Peers {
    /// Run of the RIB, as in a [`FibPush`](super::FibPush).
    pub run: u64,
    /// The RIB started recently and may not know all counterparts yet. A counterpart missing from a
    /// full list may still be attached. Another full list follows.
    pub settling: bool,
    /// Generation, which increases with every update that this RIB sends to any entity.
    pub generation: u64,
    pub extent: PeersExtent,
    /// Records in the order of their entities' names.
    pub records: Vec<Record>,
    /// Entities that are no longer counterparts.
    #[serde(rename = "gone")]
    pub departed: Vec<Name>,
    /// Newest revocation of the name, sent with part 0 of a full list and when it changes.
    pub revocation: Option<Signed<Revocation>>,
    /// Key boxes from counterparts for the entity: for the name and for the entity's inbox.
    pub boxes: Vec<Signed<KeyBox>>,
}

/// Relation of an update to the earlier ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum PeersExtent {
    /// Changes relative to the update of this generation. An entity with another generation refuses
    /// it and receives the full list.
    After(u64),
    /// Part of a full list. Counterparts that no part names are gone after the last part. The
    /// answer to a statement is part 0.
    Whole { part: u32, last: bool },
}

/// RIB → entity, relayed by switches. The RIB sends the next one about the same name once this is
/// answered.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PeersPush {
    /// Switch of the entity. Switches on the way forward the push to it, and it delivers the push
    /// to `entity`.
    pub switch: Name,
    pub entity: Name,
    pub name: Name,
    /// Role of `entity` for the name. The records are those of its counterparts.
    pub role: NameRole,
    pub peers: Peers,
}
