//! Messages between the RIBs of neighbouring domains: types only. The daemon's `tiers` send and
//! verify them.
//!
//! A message goes from a RIB to the border switch that has the link, across it, and on to the other
//! domain's RIB. The border attests the domain of the link's peer, so a domain speaks only for
//! itself. Statements of others carry the signatures of their authors.

use gdp_wire::Name;
use serde::{Deserialize, Serialize};

use crate::control::extent::Extent;
use crate::control::record::{Record, RecordKey};
use crate::control::refusal::Refusal;
use gdp_core::cert::{Host, Locator, Revocation, Signed};
use gdp_core::keys::KeyBox;
use gdp_core::name::NameProof;

/// Maximum number of domains that a record or a query passes.
pub const MAX_PATH: usize = 16;

/// Maximum number of domains above one domain.
pub const MAX_ANCESTORS: usize = 64;

/// Message between RIBs, in transit.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TierMessage {
    pub leg: TierLeg,
    pub request: TierRequest,
}

/// Leg of a message between RIBs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TierLeg {
    /// Within the sending domain, toward the border switch that has a link to switch `peer` of
    /// `domain`.
    Out { domain: Name, peer: Name },
    /// On the link between the domains.
    Across,
    /// Within the receiving domain, toward its RIB. The border states the domain whose link the
    /// message came by.
    In { from: Name },
}

/// RIB → the RIB of a neighbouring domain.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum TierRequest {
    /// Hello to a parent, first and then every few seconds: the sender is its child.
    /// [`TierResponse::Hello`] answers it. `run` is that of the pushes to the parent.
    Hello { run: u64, holds: Option<TierHolds> },
    /// Push of entries for the receiver.
    Push(Box<TierPush>),
    /// Query to a parent for the publishers and readers of a name. `path` lists the domains that
    /// have asked already, the origin of the query first.
    Query { name: Name, path: Vec<Name> },
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum TierResponse {
    Done,
    /// The push is accepted except for this number of entries or borders in locators. `reason` is
    /// that of the first refusal.
    Partly {
        refused: u32,
        reason: String,
    },
    /// Answer of a parent, with the domains above it in the order of their names.
    Hello {
        run: u64,
        holds: Option<TierHolds>,
        ancestors: Vec<Name>,
    },
    /// Answer to a query. `truncated` states that more entries exist than fit.
    Answer {
        entries: Vec<TierEntry>,
        truncated: bool,
    },
    Refused(Refusal),
}

/// Last push of the other side that was accepted. It shows the other side whether this side holds
/// what it should.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TierHolds {
    pub run: u64,
    pub generation: u64,
}

/// Change of a neighbour's entries, or part of a full transfer, like a [`FibPush`](super::FibPush)
/// for a switch.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TierPush {
    /// Run, which differs whenever the entries for this neighbour start anew: after a restart, or
    /// after a time without the neighbour.
    pub run: u64,
    /// Generation, which increases by one with each push of the run.
    pub generation: u64,
    pub extent: Extent,
    pub set: Vec<TierEntry>,
    pub remove: Vec<TierKey>,
}

/// Key of an entry.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Copy, Serialize, Deserialize)]
pub enum TierKey {
    Part(RecordKey),
    /// Key box of `writer` for `reader`.
    Box {
        writer: Name,
        reader: Name,
        name: Name,
        epoch: u32,
    },
    /// Locator of this domain.
    Locator(Name),
    /// Revocation of this name.
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
    /// Revocation of a name. Revocations by domains travel from switch to switch instead.
    Revocation {
        proof: NameProof,
        revocation: Signed<Revocation>,
    },
}

/// Registration of an entity in another domain, with everything needed to verify it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RemoteRecord {
    pub record: Record,
    /// Switch of the entity's attachment, a member of the first domain of the path.
    pub host: Host,
    /// Domains that the record passed: its own first, the announcing one last.
    pub path: Vec<Name>,
}
