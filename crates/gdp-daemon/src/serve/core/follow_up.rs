//! The steps between a request and its answer, and the requests that the local RIB sends.

use gdp_link::link::Link;
use gdp_proto::control::{NameRole, Refusal, RefusalCode, Request, Response, TierRequest, TierResponse, TraceOn};
use gdp_rib::rib::{Rib, UpdateId};
use gdp_rib::tiers::Sent;
use gdp_rib::tiers::peering::WantedPeerings;
use gdp_wire::Name;
use tokio::sync::oneshot;

use crate::config::Inside;
use crate::serve::term::Ticket;

/// The step that a request needs before its answer.
pub enum FollowUp {
    Answer(Response),
    /// The local RIB has accepted the statement. The answer waits until the switches have the new
    /// routes.
    Settle(Response, Statement),
    /// The local RIB has accepted a revocation. The answer waits until the revocation is saved.
    SaveRevocation(Response),
    /// The local RIB admits an entity by an invitation. The answer waits until this is saved. `new`
    /// is the serial of the invitation if this is its first admission of the entity.
    SaveInvitation {
        new: Option<u64>,
    },
    /// The RIB of another domain has been asked. Its answer is for a RIB, or for the client that
    /// made the query.
    Await {
        waiting: oneshot::Receiver<TierResponse>,
        is_query: bool,
    },
    /// The trace of a name continues in another domain, or in this one.
    Trace(Box<Tracing>),
    /// The changes in the local RIB must be stored before the next step.
    Store(Ticket, Box<FollowUp>),
    /// The RIB has asked this switch to report again.
    Report,
    /// This switch sends the request over the link and returns the response to its client.
    Forward(Link, Request),
    /// The endpoint at the other end of these links must attach again over each. A link over which
    /// it does not is closed.
    Reattach(Vec<Link>, Request),
}

/// A statement of an entity: its role for a name, at a switch.
pub struct Statement {
    pub name: Name,
    pub entity: Name,
    pub role: NameRole,
    pub switch: Name,
}

impl Statement {
    pub fn is_settled(&self, rib: &Rib) -> bool {
        rib.is_settled(&self.name, &self.entity, self.role)
    }

    pub fn check_room(&self, rib: &mut Rib) -> Result<(), Refusal> {
        rib.check_room(&self.name, &self.entity, self.role, &self.switch)
    }
}

/// A trace that a switch of this domain or a border of another one requested.
pub enum Tracing {
    /// The path of the name leaves this domain over the link, into `domain`.
    Leaves { link: Link, domain: Name, request: TraceOn },
    /// The trace came from another domain.
    Enters(TraceEntry),
}

/// A trace of a name through this domain, for another domain that may send to the name.
pub struct TraceEntry {
    pub request: TraceOn,
    pub home: Name,
    /// The neighbouring domain that asks. `from` is its border switch that sends the frames.
    pub asked_by: Name,
    pub from: Name,
    /// Whether frames of the domain may transit to a third domain.
    pub may_cross: bool,
    pub visibility: Inside,
    pub egress: Vec<Name>,
}

/// A request of the local RIB, and the link to its first hop if there is one.
pub struct PendingRequest {
    pub link: Option<Link>,
    pub request: Request,
    pub on_reply: OnReply,
}

/// The use of the reply to a request of the RIB.
pub enum OnReply {
    /// Whether a switch has asked this entity to attach again.
    Detach(Name, Name),
    /// The outcome of a FIB push to a switch, with the push's generation.
    Push(Name, u64),
    /// Whether an entity received the update of its peers.
    PeerUpdate(UpdateId),
    /// The answer of another domain's RIB.
    Tier(Name, Sent),
    /// Whether a border received the list of peerings that it should have.
    Peerings(Name),
    /// Whether the endpoint attached again. If not, its link is closed.
    Reattach,
}

/// A message of the local RIB that concerns other domains.
pub enum FederationEffect {
    /// A message to the RIB of another domain.
    Message { to: Name, sent: Sent, request: TierRequest },
    /// The peerings that the RIB of this run wants a border to have.
    Peerings { border: Name, run: u64, wanted: WantedPeerings },
}

pub fn refuse(code: RefusalCode, reason: impl Into<String>) -> FollowUp {
    FollowUp::Answer(Refusal::new(code, reason).into())
}
