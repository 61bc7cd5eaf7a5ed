//! What the RIBs of neighbouring domains tell each other: types only. The daemon's `tiers` send and
//! judge them.
//!
//! A message goes from a RIB to the border switch that has the link, across it, and on to the other
//! domain's RIB. The border attests the domain of the link's peer, so a domain speaks only for
//! itself; for what others are said to have stated, they have signed.

use gdp_wire::Name;
use serde::{Deserialize, Serialize};

use crate::control::extent::Extent;
use crate::control::record::{Record, RecordKey};
use crate::control::refusal::Refusal;
use gdp_core::cert::{Host, Locator, Revocation, Signed};
use gdp_core::keys::KeyBox;
use gdp_core::name::NameProof;

/// Domains that a record comes through, or a query, at most.
pub const MAX_PATH: usize = 16;

/// Domains above one, at most.
pub const MAX_ANCESTORS: usize = 64;

/// A message between RIBs, on its way.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TierMessage {
    pub leg: TierLeg,
    pub request: TierRequest,
}

/// How far a message between RIBs has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TierLeg {
    /// Within its own domain: for the border switch that has a link to this one of this domain.
    Out { domain: Name, peer: Name },
    /// On that link.
    Across,
    /// Within the other domain: for its RIB. The border says whose link it came by.
    In { from: Name },
}

/// RIB → the RIB of a neighbouring domain.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum TierRequest {
    /// To a parent, first and every few seconds: I am your child. Answered with
    /// [`TierResponse::Hello`]. `run`: of the pushes to that one.
    Hello { run: u64, holds: Option<TierHolds> },
    /// What I have for you.
    Push(Box<TierPush>),
    /// To a parent: who publishes and reads this name? `path`: the domains that have asked already,
    /// the first of them for itself.
    Query { name: Name, path: Vec<Name> },
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum TierResponse {
    Done,
    /// Taken in but for so many entries, or borders in locators, of which this is the reason of the
    /// first.
    Partly {
        refused: u32,
        reason: String,
    },
    /// Of a parent: the domains above it, in the order of their names.
    Hello {
        run: u64,
        holds: Option<TierHolds>,
        ancestors: Vec<Name>,
    },
    /// To a query. `truncated`: there are more than fit.
    Answer {
        entries: Vec<TierEntry>,
        truncated: bool,
    },
    Refused(Refusal),
}

/// Which push of the other side was the last that was taken in: so it sees whether this side holds
/// what it should.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TierHolds {
    pub run: u64,
    pub generation: u64,
}

/// A change of what a neighbour is told, or a part of its whole, as a [`FibPush`](super::FibPush)
/// is for a switch.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TierPush {
    /// Another number whenever what this neighbour is told begins anew: after a restart, or when it
    /// was no neighbour for a while.
    pub run: u64,
    /// Counts up by one with each push of the run.
    pub generation: u64,
    pub extent: Extent,
    pub set: Vec<TierEntry>,
    pub remove: Vec<TierKey>,
}

/// Something that is told of another domain.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Copy, Serialize, Deserialize)]
pub enum TierKey {
    Part(RecordKey),
    /// A key of `writer` for `reader`.
    Box {
        writer: Name,
        reader: Name,
        name: Name,
        epoch: u32,
    },
    /// Where this domain can be reached.
    Locator(Name),
    /// What the owner of this name has taken back.
    Revocation(Name),
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum TierEntry {
    Part(Box<RemoteRecord>),
    Box(Signed<KeyBox>),
    Locator {
        domain: Name,
        locator: Locator,
    },
    /// Of a name; what domains take back goes from switch to switch.
    Revocation {
        proof: NameProof,
        revocation: Signed<Revocation>,
    },
}

/// One entity's part in a name, in another domain, with all that is needed to verify it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RemoteRecord {
    pub record: Record,
    /// The switch that the entity is attached to, which is of the first domain of the path.
    pub host: Host,
    /// The domains that it came through, its own first and the one that says it last.
    pub path: Vec<Name>,
}
