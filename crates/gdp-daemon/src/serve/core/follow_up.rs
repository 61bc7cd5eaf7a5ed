//! What a request needs before it is answered, and what the RIB here sends.

use gdp_link::link::Link;
use gdp_proto::control::{NameRole, Refusal, RefusalCode, Request, Response, TierRequest, TierResponse, TraceOn};
use gdp_rib::rib::{Rib, UpdateId};
use gdp_rib::tiers::Sent;
use gdp_rib::tiers::peering::WantedPeerings;
use gdp_wire::Name;
use tokio::sync::oneshot;

use crate::config::Inside;
use crate::serve::term::Ticket;

/// What a request needs before it can be answered.
pub enum FollowUp {
    Answer(Response),
    /// The RIB here has accepted the statement; switches are still to be given the routes that
    /// follow.
    Settle(Response, Statement),
    /// The RIB here has accepted a revocation, which is to be saved before it is confirmed.
    SaveRevocation(Response),
    /// The RIB here admits an entity by an invitation, which is likewise to be saved. `new`: the
    /// invitation's serial, if it had admitted nobody before.
    SaveInvitation {
        new: Option<u64>,
    },
    /// Another domain's RIB is asked; its answer is for a RIB, or for whoever made the query.
    Await {
        waiting: oneshot::Receiver<TierResponse>,
        is_query: bool,
    },
    /// The trace of a name continues in another domain, or in this one.
    Trace(Box<Tracing>),
    /// What the RIB here has accepted is to be stored before anything else.
    Store(Ticket, Box<FollowUp>),
    /// The RIB has asked this switch to report again.
    Report,
    /// Ask over this link, and pass the response on.
    Forward(Link, Request),
    /// Have the endpoint at the other end of these links attach again by each, or close the link.
    Reattach(Vec<Link>, Request),
}

/// What an entity has stated: what it is to the name, at a switch.
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

/// A trace that a switch of this domain, or a border of another one, has asked for.
pub enum Tracing {
    /// The name leaves by this link into that domain.
    Leaves { link: Link, domain: Name, request: TraceOn },
    /// The trace has come from another domain.
    Enters(TraceEntry),
}

/// A trace of a name through this domain, for another domain that may send to the name.
pub struct TraceEntry {
    pub request: TraceOn,
    pub home: Name,
    /// Which domain asks, and by which border switch of it the frames come.
    pub asked_by: Name,
    pub from: Name,
    /// Frames of the domain may go on to a third domain.
    pub may_cross: bool,
    pub visibility: Inside,
    pub egress: Vec<Name>,
}

/// A request of the RIB here, and the first link on its way, if there is one.
pub struct PendingRequest {
    pub link: Option<Link>,
    pub request: Request,
    pub on_reply: OnReply,
}

/// What the reply to a request of the RIB is for.
pub enum OnReply {
    Nothing,
    /// The outcome of the RIB's push of this generation to this switch.
    Push(Name, u64),
    /// Whether an entity received the update on its counterparts.
    PeerUpdate(UpdateId),
    /// The answer of another domain's RIB.
    Tier(Name, Sent),
    /// Whether a border knows which peerings are wanted of it.
    Peerings(Name),
    /// Whether the endpoint has attached again; if not, its link is closed.
    Reattach,
}

/// What the RIB here sends because of other domains.
pub enum FederationEffect {
    /// To the RIB of another domain.
    Message { to: Name, sent: Sent, request: TierRequest },
    /// The RIB of this run wants these peerings of a border.
    Peerings { border: Name, run: u64, wanted: WantedPeerings },
}

pub fn refuse(code: RefusalCode, reason: impl Into<String>) -> FollowUp {
    FollowUp::Answer(Refusal::new(code, reason).into())
}
