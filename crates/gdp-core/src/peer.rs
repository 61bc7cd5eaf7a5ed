//! Entity at the other end of a link.

use std::time::Duration;

use gdp_wire::table::LinkRole;
use serde::{Deserialize, Serialize};

use crate::name::{Name, NameProof};
use crate::verify_key::VerifyKey;

/// Time in which keys and routes of a lost link stay in use, unless a new link replaces it earlier
/// (RFC 4724, section 4.2).
///
/// The daemon of a switch may be down while its kernel continues to forward. The neighbour's data
/// plane must answer echoes meanwhile.
pub const GRACEFUL_RESTART_TIME: Duration = Duration::from_secs(60);

/// Maximum number of concurrent links of an endpoint, to one switch or several.
pub const MAX_LANES: usize = 4;

/// Role of an entity on its links.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Role {
    Endpoint,
    Switch,
}

impl From<Role> for LinkRole {
    fn from(role: Role) -> Self {
        match role {
            Role::Endpoint => Self::Endpoint,
            Role::Switch => Self::Switch,
        }
    }
}

/// Identity of the other end. The key is proven and the name derived from it; the role is its own
/// claim.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Peer {
    pub name: Name,
    pub proof: NameProof,
    pub key: VerifyKey,
    pub role: Role,
    /// Number of an endpoint's link among its concurrent ones, below [`MAX_LANES`].
    pub lane: u8,
}
