//! Messages on a link's control streams: requests, responses and the records in them, with their
//! bounded encoding.
//!
//! Types and checks only, no I/O: `gdp-link` transports them, `gdp` sends requests, the daemon's
//! RIB answers. Each QUIC stream carries one request and its response. Each is a big-endian u32
//! length and that many bytes of CBOR, at most [`MAX_MESSAGE`]. Streams are not ordered among each
//! other: a sender that needs an order waits for the response before its next request.
//!
//! No sender is trusted: the RIB verifies certificates and statements before it stores them. The
//! receiver of an answer verifies them again with [`Record::verify`].

mod extent;
mod inspection;
mod peers;
mod record;
mod refusal;
mod role;
mod tiers;
mod traced;

pub use crate::control::extent::Extent;
pub use crate::control::record::{Credential, Record, RecordKey, Verified};
pub use crate::control::refusal::{Refusal, RefusalCode};
pub use crate::control::role::NameRole;
pub use inspection::{
    AttachmentStatus, Inspected, Inspection, MAX_STATED_LINKS, MAX_STATED_NAMES, NameLocation, OwnLink, OwnName,
    ProbeEnd,
};
pub use peers::{Peers, PeersExtent, PeersPush};
pub use tiers::{
    MAX_ANCESTORS, MAX_PATH, RemoteRecord, TierEntry, TierHolds, TierKey, TierLeg, TierMessage, TierPush, TierRequest,
    TierResponse,
};
pub use traced::{
    Crossing, MAX_BEYOND, MAX_TRACED_DOMAINS, MAX_TRACED_SWITCHES, TraceLeg, TraceOn, Traced, TracedDomain, TracedEnd,
    TracedSwitch,
};

use std::collections::BTreeMap;
use std::net::SocketAddr;

use gdp_util::escape::Escaped;
use gdp_wire::Name;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use gdp_core::cbor;
use gdp_core::cert::{
    AdCert, Advert, CertError, Host, Issued, LinkState, Membership, Reading, Revocation, RtCert, Signed,
};
use gdp_core::domain::Credentials;
use gdp_core::keys::KeyBox;
use gdp_core::name::{NamePrefix, NameProof};

/// Maximum bytes of an encoded request or response, without its length prefix.
pub const MAX_MESSAGE: usize = 64 * 1024;

/// Maximum number of hops of a control message between switches. Any longer path would be too slow.
pub const MAX_HOPS: u8 = 64;

/// Characters of an unknown kind that are shown.
const LONGEST_KIND: usize = 64;

/// Maximum nesting depth of a message; the deepest real one has fifteen levels.
const MAX_DEPTH: usize = 24;

/// Request from one side of a link to the other.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Request {
    /// Endpoint → its switch: a request of the entity at the other end of the link.
    Entity(EntityRequest),
    /// Switch → neighbouring switch: a request to forward to the switch `to`, or to the RIB beside
    /// it. Each switch forwards it along the shortest path with one hop less, and returns the
    /// answer. Requests between switches and the RIB travel this way.
    Onward { to: Name, hops: u8, request: Box<Request> },
    /// Switch → RIB: a request of an entity attached to `switch`, or of a tool on its host.
    ///
    /// `entity` proves the key that verifies the entity's statements. It is `None` for revocations
    /// and for queries of a full name. `by_tool` states that the request did not arrive over a link
    /// of the entity. Its registrations are then bound to the statement's lifetime only, not to an
    /// attachment.
    Relay { switch: Name, entity: Option<NameProof>, by_tool: bool, request: EntityRequest },
    /// Switch → RIB: a report of the attached entities, sent whenever the switch reaches a RIB, for
    /// the first time or again.
    ///
    /// The RIB ends other attachments that it holds for the switch. It answers entities that it
    /// does not know with [`Request::Detach`], so that they attach again. A restarted daemon
    /// reports the entities whose links it took over. `own_bit` is the switch's previous egress
    /// bit. Frames in flight carry it, so a RIB that does not know the switch assigns the same bit
    /// if it is free. `membership` is the identity for other domains, if the switch is a member of
    /// a domain.
    Report {
        switch: NameProof,
        attached: Vec<Name>,
        own_bit: Option<u8>,
        #[serde(rename = "shown")]
        membership: Option<Box<Host>>,
    },
    /// RIB → its border switch: the complete set of wanted links to border switches of other
    /// domains, each with its addresses, best first. `run` is the same as in [`FibPush`].
    Peerings { run: u64, wanted: Vec<(Name, Vec<SocketAddr>)> },
    /// RIB → its border switch → the border switch of a neighbouring domain → that domain's RIB.
    Tier(Box<TierMessage>),
    /// Switch → neighbouring switch: the link states that the neighbour may lack. The neighbour
    /// answers once it holds them; until then they are repeated.
    Flood { states: Vec<Flooded> },
    /// Switch → RIB: the entity's link is gone, and with it everything it advertised through this
    /// switch.
    ///
    /// RIB → switch → entity: the RIB holds no attachment of the entity, which must attach again on
    /// its present link.
    Detach { switch: Name, entity: Name },
    /// Switch → neighbouring switch: this side accepts data frames on this link from now on.
    /// Endpoint → its switch: of the links between the two, use this one for names that the
    /// endpoint accepts on a single link.
    Ready,
    /// RIB → switch: content of the switch's FIB.
    Fib(FibPush),
    /// RIB → switch → entity: the entity's counterparts for a name.
    Peers(PeersPush),
    /// Endpoint → its switch: subscribes to the path costs to each switch of the domain, for
    /// choosing among servers. [`Response::Costs`] answers it, and changes arrive as
    /// [`Request::Costs`] on this link.
    WatchCosts,
    /// Switch → subscribed endpoint: the current path costs. The next update follows a while after
    /// this one is answered.
    Costs(PathCosts),
    /// Either end of a link → the other: the sender's data frames now use the link key of this
    /// generation. The receiver answers once it holds the next key; until then the key does not
    /// change again.
    Ratcheted { generation: u64 },
    /// Either end of a link → the other: renewed credentials. If they are not valid, the answer
    /// states the reason, and the previous credentials stay in force.
    #[serde(rename = "Papers")]
    Credentials(Box<Credentials>),
    /// Either end of a link → the other: a domain's revocation. Each side sends those of all
    /// related domains at the start of a link, and new ones when they arrive. The domain's
    /// signature authenticates it, not the sender.
    DomainRevoked { proof: NameProof, revocation: Signed<Revocation> },
    /// Switch → RIB: asks whether this entity is the one admitted by its invitation. The first
    /// entity to ask is admitted.
    Admitted { switch: Name, entity: Name, membership: Box<Membership> },
    /// Switch → switch: the receiver's probe ended at the sender.
    Traced(Traced),
    /// Switch → its border switch → the border switch of a neighbouring domain: a request to trace
    /// a name onward there.
    TraceOn(TraceOn),
    /// Endpoint → its switch: a question about its attachment, or about the path of a name to which
    /// it may send. [`Response::Inspected`] answers it.
    Inspect(Inspection),
}

/// Request of an entity to the RIB, through the switch of its attachment.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum EntityRequest {
    /// Attaches the entity: the switch may carry its traffic and use this link for data frames. It
    /// is the first request on every link of an endpoint. [`Response::Attached`] answers it.
    ///
    /// `resumes` states that the entity's earlier advertisements stay valid. Otherwise the entity
    /// has started anew, and the RIB ends its earlier attachments. `lane` is the number of the link
    /// among the entity's concurrent ones, below [`MAX_LANES`](gdp_core::peer::MAX_LANES). An
    /// earlier attachment of that lane ends.
    Attach { rt_cert: Signed<RtCert>, resumes: bool, lane: u8 },
    /// Advertises that the entity publishes or serves a name. It lasts as long as the attachment,
    /// or the statement's lifetime if that ends first.
    ///
    /// [`Response::Peers`] answers it, as it answers a subscription, with the readers or callers.
    /// Changes arrive as [`PeersPush`]. `everywhere` states that the entity's statements about the
    /// name at other switches stay valid. The switch then delivers the name on each of the entity's
    /// links. Otherwise this switch alone counts, and delivery uses one link.
    Advertise { proof: NameProof, ad_cert: Issued<AdCert>, advert: Signed<Advert>, everywhere: bool },
    /// Subscribes to or calls a name. The answer holds its publishers or servers.
    Subscribe { proof: NameProof, grant: Reading, advert: Signed<Advert>, everywhere: bool },
    /// Withdraws the entity's statements about the name.
    Withdraw { advert: Signed<Advert> },
    /// Stores the keys with which the entity sends, each wrapped for one reader. They last as long
    /// as the entity's statement. The RIB sends them to each reader when it subscribes or when they
    /// arrive.
    KeyBoxes { boxes: Vec<Signed<KeyBox>> },
    /// Revokes certificates of a name. Any sender may deliver it, even without identifying itself,
    /// because the owner's signature authenticates it.
    Revoke { proof: NameProof, revocation: Signed<Revocation> },
    /// Queries the registrations of names with this prefix, after the record `after`.
    /// [`Response::Records`] answers it.
    Query { prefix: NamePrefix, after: Option<RecordKey> },
}

/// Response to a request.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Response {
    Done,
    /// The entity is attached. `serial` is the highest serial that the RIB has seen from it; the
    /// next statement needs a higher one.
    Attached {
        serial: u64,
    },
    /// This [run](FibPush::run) of the RIB accepted the report. The switch follows this run from
    /// now on, even if an earlier one had a higher number.
    Reported {
        run: u64,
    },
    /// Records in the order of their [keys](RecordKey). `truncated` states that more follow; query
    /// again after the last one.
    Records {
        records: Vec<Record>,
        truncated: bool,
    },
    /// The statement is accepted. These are all counterparts or the first of them; pushes bring the
    /// rest.
    Peers(Peers),
    /// Response of another domain's RIB.
    Tier(Box<TierResponse>),
    /// Path costs from the switch that answers.
    Costs(PathCosts),
    /// Answer of a border: the domain behind its link and the domains behind that one, in
    /// depth-first order.
    TracedOn {
        domains: Vec<TracedDomain>,
    },
    /// Answer of a switch to an attached endpoint.
    Inspected(Inspected),
    Refused(Refusal),
}

/// Path costs to each reachable switch of a domain, at most one entry for each switch. They are not
/// signed, because the stating switch forwards all frames to those switches anyway.
pub type PathCosts = BTreeMap<Name, u64>;

impl From<Refusal> for Response {
    fn from(refusal: Refusal) -> Self {
        Self::Refused(refusal)
    }
}

/// Change of a switch's FIB, or part of a full transfer. The RIB sends the next one once this is
/// answered.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FibPush {
    /// Switch that owns the FIB.
    pub switch: Name,
    /// Run of the RIB, which is higher after a restart or on another replica. A switch that follows
    /// a higher run refuses the push.
    pub run: u64,
    /// The RIB started recently and may not know all registrations yet. Routes of an earlier RIB
    /// stay valid, unless [`Self::remove`] removes them.
    pub settling: bool,
    /// Generation, which increases by one with each push to this switch.
    pub generation: u64,
    pub extent: Extent,
    /// Index (0 to 63) of the switch's own egress bit.
    pub own_bit: u8,
    pub set: Vec<Route>,
    pub remove: Vec<Name>,
}

/// Route of a name, in terms of names. The switch maps entities and neighbours to its links.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Route {
    pub name: Name,
    /// Egress switches for the name, at switches where frames enter. 0 elsewhere.
    pub egress_bits: u64,
    /// Local endpoints that receive the name, at their egress switch. There are at most as many as
    /// a switch has links. An entity receives its own name.
    pub locals: Vec<Name>,
    /// Local endpoints that receive the name on each of their links to the switch. The others
    /// receive it on one.
    pub everywhere: Vec<Name>,
    /// Local endpoints that may send to the name: its publishers at this switch, or for an inbox,
    /// the counterparts of its entity.
    pub writers: Vec<Name>,
    /// Switches of other domains from which a border may receive frames of this name, if the name
    /// is that of a remote entity. [`Self::locals`] and [`Self::writers`] also list such switches,
    /// for the entities behind them.
    pub arrives_by: Vec<Name>,
}

/// Link state of a switch, as it is flooded.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Flooded {
    /// Proof of the switch's name, which holds its key.
    pub proof: NameProof,
    pub state: Signed<LinkState>,
    /// Remaining lifetime in seconds, as counted by the forwarding switch.
    pub expires_in: u32,
}

impl Flooded {
    /// Verifies that the switch itself signed the link state, and returns it.
    pub fn verify(&self) -> Result<LinkState, CertError> {
        let claims = self.state.verify_signature(&self.proof.verify_key()?)?;
        let got = self.proof.name()?;
        if claims.switch != got {
            return Err(CertError::WrongName { expected: claims.switch, got });
        }
        Ok(claims)
    }
}

/// Error of encoding or decoding a message.
#[derive(Debug, thiserror::Error)]
pub enum CodecError {
    #[error("a control message of {0} bytes exceeds the limit of {MAX_MESSAGE}")]
    TooLong(usize),
    #[error("not a control message this version understands: {0}")]
    Malformed(String),
    /// A request, or a part of a message, of a kind that a later release may have added.
    #[error("{0} is of a later release than the node that received it; run the later one at both ends")]
    Unknown(String),
}

impl CodecError {
    /// Returns the code with which the sender of such a request is refused.
    pub fn code(&self) -> RefusalCode {
        match self {
            Self::Unknown(_) => RefusalCode::Unsupported,
            Self::TooLong(_) | Self::Malformed(_) => RefusalCode::Malformed,
        }
    }
}

/// Encodes a message with its length prefix, as sent on a stream.
pub fn encode<T: Serialize>(message: &T) -> Result<Vec<u8>, CodecError> {
    let mut bytes = vec![0; 4];
    ciborium::into_writer(message, &mut bytes).map_err(|error| CodecError::Malformed(error.to_string()))?;
    let length = bytes.len() - 4;
    if length > MAX_MESSAGE {
        return Err(CodecError::TooLong(length));
    }
    bytes[..4].copy_from_slice(&(length as u32).to_be_bytes());
    Ok(bytes)
}

/// Returns the length in a message's prefix. Refuses a length above [`MAX_MESSAGE`].
pub fn decode_length(prefix: [u8; 4]) -> Result<usize, CodecError> {
    let length = u32::from_be_bytes(prefix) as usize;
    if length > MAX_MESSAGE { Err(CodecError::TooLong(length)) } else { Ok(length) }
}

/// Returns the error of a message that does not decode. An unknown kind is named, without control
/// characters.
fn undecodable(error: &ciborium::de::Error<std::io::Error>) -> CodecError {
    // The text that `serde::de::Error::unknown_variant` specifies.
    let unknown = match error {
        ciborium::de::Error::Semantic(_, text) => text.strip_prefix("unknown variant `"),
        _ => None,
    };
    match unknown.and_then(|text| text.split_once("`, expected ")) {
        Some((kind, _)) => {
            let kind: String = kind.chars().take(LONGEST_KIND).collect();
            CodecError::Unknown(Escaped(kind).to_string())
        }
        None => CodecError::Malformed(cbor::explain(error)),
    }
}

/// Decodes a message without its length prefix. Refuses trailing bytes.
pub fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, CodecError> {
    if bytes.len() > MAX_MESSAGE {
        return Err(CodecError::TooLong(bytes.len()));
    }
    let mut rest = bytes;
    let message =
        ciborium::de::from_reader_with_recursion_limit(&mut rest, MAX_DEPTH).map_err(|error| undecodable(&error))?;
    if !rest.is_empty() {
        return Err(CodecError::Malformed(format!("{} bytes behind the message", rest.len())));
    }
    Ok(message)
}

impl Response {
    /// Returns the response, or the refusal as an error.
    pub fn accepted(self) -> Result<Self, Refusal> {
        match self {
            Self::Refused(refusal) => Err(refusal),
            response => Ok(response),
        }
    }
}

#[cfg(test)]
#[path = "../tests/unit/control.rs"]
mod tests;
