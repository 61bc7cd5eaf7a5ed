//! What travels on a link's control streams: requests, responses and the records in them, and their
//! bounded encoding.
//!
//! Types and checks only, no I/O: `gdp-link` moves them, `gdp` asks, the daemon's
//! RIB answers. One request and its response to a QUIC stream, each a big-endian u32 length and
//! that many bytes of CBOR, at most [`MAX_MESSAGE`]. Streams are not ordered among each other: who
//! needs an order waits for the response before asking again.
//!
//! Nothing here is trusted because of who sent it: certificates and statements are verified by the
//! RIB before it stores them and again, with [`Record::verify`], by whoever receives an answer.

mod extent;
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

use gdp_wire::Name;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use gdp_core::cert::{
    AdCert, Advert, CertError, Host, Issued, LinkState, Membership, Reading, Revocation, RtCert, Signed,
};
use gdp_core::domain::Credentials;
use gdp_core::keys::KeyBox;
use gdp_core::name::{NamePrefix, NameProof};

/// Largest encoded request or response, in bytes, without its length prefix.
pub const MAX_MESSAGE: usize = 64 * 1024;

/// Hops that control goes between switches, at most: more than any path has on which it arrives in
/// time.
pub const MAX_HOPS: u8 = 64;

/// Deepest nesting of a message; the deepest real one has fifteen levels.
const MAX_DEPTH: usize = 24;

/// Whatever one side of a link asks of the other.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Request {
    /// Endpoint → its switch: on behalf of the entity at the other end of the link.
    Entity(EntityRequest),
    /// Switch → neighbouring switch: a request to the switch `to`, or to the RIB beside it; pass it
    /// on along the shortest path, with one hop less, and its answer back. What a switch asks of
    /// the RIB goes so, and what the RIB says to a switch.
    Onward { to: Name, hops: u8, request: Box<Request> },
    /// Switch → RIB: what an entity attached to `switch` (or a tool on its host) asks. `entity`
    /// shows the RIB the key that the entity's statements must verify under; `None` for
    /// revocations, and for queries of a name in full. `by_tool`: not over a link of the entity, so
    /// nothing is bound to an attachment, only to the statement's lifetime.
    Relay { switch: Name, entity: Option<NameProof>, by_tool: bool, request: EntityRequest },
    /// Switch → RIB, first when it reaches that RIB, and when it reaches it again: I am here, with
    /// these entities attached. The RIB drops those it holds beyond these, and answers those it
    /// does not hold with [`Request::Detach`], so that they attach again. A switch whose daemon has
    /// just started names those whose links it took over. `own_bit`: the egress bit it had, if it
    /// had one; frames on their way carry it, so a RIB that does not know the switch gives it the
    /// same one if nobody else has it. `shown`: what other domains may see of it, if it is a member
    /// of a domain.
    Report { switch: NameProof, attached: Vec<Name>, own_bit: Option<u8>, shown: Option<Box<Host>> },
    /// RIB → its border switch: have links with these border switches of other domains, which may
    /// be reached at these addresses, best first, and with no others that I wanted. `run`: as in
    /// [`FibPush`].
    Peerings { run: u64, wanted: Vec<(Name, Vec<SocketAddr>)> },
    /// RIB → its border switch → the border switch of a neighbouring domain → that domain's RIB.
    Tier(Box<TierMessage>),
    /// Switch → neighbouring switch: what switches of the domain state of their links, as far as
    /// the neighbour is not known to hold it. Answered once it does; until then it is sent again.
    Flood { states: Vec<Flooded> },
    /// Switch → RIB: the entity's link is gone, and with it everything it advertised through this
    /// switch. RIB → switch → the entity: I hold no attachment of it; it is to attach again, on the
    /// link it has.
    Detach { switch: Name, entity: Name },
    /// Switch → neighbouring switch: data frames are taken on this link from now on. Endpoint → its
    /// switch: of my links to you, send me on this one what I take on one.
    Ready,
    /// RIB → switch: what the switch's FIB holds.
    Fib(FibPush),
    /// RIB → switch → entity: its counterparts in a name are now these.
    Peers(PeersPush),
    /// Endpoint → its switch: what does the path to each switch of the domain cost, now and
    /// whenever that changes? For one that chooses among servers. Answered by [`Response::Costs`];
    /// changes come as [`Request::Costs`], on this link.
    WatchCosts,
    /// Switch → an endpoint that watches: the paths cost this now. The next comes once this is
    /// answered, and a while after.
    Costs(PathCosts),
    /// Either end of a link → the other: my data frames are now under the link key of this
    /// generation. Answered once the one after it is held; until then there is no further change.
    Ratcheted { generation: u64 },
    /// Either end of a link → the other: my membership, or what my domain lets others do, was
    /// renewed. If it does not hold, the answer says why, and what was shown before goes on to
    /// count.
    Papers(Box<Credentials>),
    /// Either end of a link → the other: a domain has taken certificates back. Sent of all domains
    /// that the sender has to do with, first on every link and whenever there is news; it is the
    /// domain's signature that counts.
    DomainRevoked { proof: NameProof, revocation: Signed<Revocation> },
    /// Switch → RIB: this entity shows a membership by an invitation; is it the one that was
    /// admitted? The first that asks is.
    Admitted { switch: Name, entity: Name, membership: Box<Membership> },
    /// Switch → switch: a probe of yours ended here.
    Traced(Traced),
    /// Switch → its border switch → the border switch of a neighbouring domain: trace a name on
    /// there.
    TraceOn(TraceOn),
}

/// What an entity may ask of the RIB, through the switch it is attached to.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum EntityRequest {
    /// First on every link of an endpoint: this switch may carry my traffic, and data frames are
    /// taken on this link from now on. Answered by [`Response::Attached`]. `resumes`: what this
    /// entity advertised before stands; otherwise it has started anew, and what the RIB holds of
    /// its last attachments ends. `lane`: which of its links this is, of those it has at once
    /// (below [`MAX_LANES`](gdp_core::peer::MAX_LANES)): what that was attached to before, it is no
    /// more.
    Attach { rt_cert: Signed<RtCert>, resumes: bool, lane: u8 },
    /// I publish or serve a name. Lives as long as the attachment, or the statement's lifetime if
    /// that ends first. Answered, as a subscription is, by [`Response::Peers`] with its readers or
    /// callers; changes come as [`PeersPush`]. `everywhere`: what I stated of this at other
    /// switches stands, and if I take the name, this switch sends it on each of my links to it.
    /// Otherwise this is where I publish or serve it now, and what I take comes on one link.
    Advertise { proof: NameProof, ad_cert: Issued<AdCert>, advert: Signed<Advert>, everywhere: bool },
    /// I read or call a name. Answered with its publishers or servers.
    Subscribe { proof: NameProof, grant: Reading, advert: Signed<Advert>, everywhere: bool },
    /// I have no part any more in the name in the statement.
    Withdraw { advert: Signed<Advert> },
    /// The keys of what I send, each wrapped for one reader. Kept beside what I stated, for as long
    /// as that; given to each reader when it states that it takes the name, and when they come.
    KeyBoxes { boxes: Vec<Signed<KeyBox>> },
    /// The owner of a name takes certificates back. Anybody may pass this on, also without showing
    /// who it is: the owner's signature is what counts.
    Revoke { proof: NameProof, revocation: Signed<Revocation> },
    /// Who publishes and reads the names that begin so? Answered by [`Response::Records`], from the
    /// one behind `after` on.
    Query { prefix: NamePrefix, after: Option<RecordKey> },
}

/// The answer to a request.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Response {
    Done,
    /// Attached. `serial` is the highest serial the RIB has seen from this entity: its next
    /// statement needs a higher one.
    Attached {
        serial: u64,
    },
    /// Taken, by this [run](FibPush::run) of the RIB: it is the one to follow now, also if an
    /// earlier one had a higher number.
    Reported {
        run: u64,
    },
    /// In the order of their [places](RecordKey). `truncated`: there are more than fit an answer;
    /// ask for those behind the last one.
    Records {
        records: Vec<Record>,
        truncated: bool,
    },
    /// Accepted; these are the counterparts, or the first of them: then pushes bring the others.
    Peers(Peers),
    /// Of another domain's RIB.
    Tier(Box<TierResponse>),
    /// What paths cost from the switch that answers.
    Costs(PathCosts),
    /// Of a border: the domain behind its link, and those behind that one, each before those that
    /// are behind it.
    TracedOn {
        domains: Vec<TracedDomain>,
    },
    Refused(Refusal),
}

/// What the path to each switch of a domain costs that there is one to. Unsigned: who states it is
/// the switch that all frames to those switches go by. At most as many as a domain has switches.
pub type PathCosts = BTreeMap<Name, u64>;

impl From<Refusal> for Response {
    fn from(refusal: Refusal) -> Self {
        Self::Refused(refusal)
    }
}

/// A change of a switch's FIB, or a part of its whole. The RIB sends the next one once this is
/// answered.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FibPush {
    /// Whose FIB.
    pub switch: Name,
    /// Which run of a RIB this is: after a restart, or of another replica, a higher number. A
    /// switch that follows a higher one refuses.
    pub run: u64,
    /// The RIB has started so recently that it may not know all there is: what an earlier one said
    /// counts besides, unless [`Self::remove`] takes it back.
    pub settling: bool,
    /// Counts up by one with each push to this switch.
    pub generation: u64,
    pub extent: Extent,
    /// Index (0 … 63) of the switch's own egress bit.
    pub own_bit: u8,
    pub set: Vec<Route>,
    pub remove: Vec<Name>,
}

/// Where a name leads, in names: the switch translates entities and neighbours to its links.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Route {
    pub name: Name,
    /// Egress switches that want the name; for switches with somebody who sends to it. 0 elsewhere.
    pub egress_bits: u64,
    /// The local endpoints that take the name, at their egress switch; as many as a switch has
    /// links, at most. An entity takes its own.
    pub locals: Vec<Name>,
    /// Those of them that take it on each of their links to the switch; the others do on one.
    pub everywhere: Vec<Name>,
    /// The local endpoints that may send to the name: those that publish it through this switch; to
    /// the name of an entity, its counterparts.
    pub writers: Vec<Name>,
    /// The switches of other domains that frames from this name may come from, at a border: if it
    /// is that of an entity abroad. They stand among [`Self::locals`] and [`Self::writers`], too,
    /// for the entities behind them.
    pub arrives_by: Vec<Name>,
}

/// What a switch states of its links, as it is passed on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Flooded {
    /// How the name of the switch is derived, and its key.
    pub proof: NameProof,
    pub state: Signed<LinkState>,
    /// Seconds that are left of its lifetime, as whoever passes it on counts them.
    pub expires_in: u32,
}

impl Flooded {
    /// What it states, if the switch itself stated it.
    pub fn verify(&self) -> Result<LinkState, CertError> {
        let claims = self.state.verify_signature(&self.proof.verify_key()?)?;
        let got = self.proof.name()?;
        if claims.switch != got {
            return Err(CertError::WrongName { expected: claims.switch, got });
        }
        Ok(claims)
    }
}

/// Why a message could not be encoded or decoded.
#[derive(Debug, thiserror::Error)]
pub enum CodecError {
    #[error("a control message of {0} bytes exceeds the limit of {MAX_MESSAGE}")]
    TooLong(usize),
    #[error("not a control message this version understands: {0}")]
    Malformed(String),
}

/// Encodes a message with its length in front, as it goes on a stream.
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

/// The length in a message's prefix, if such a message is allowed.
pub fn decode_length(prefix: [u8; 4]) -> Result<usize, CodecError> {
    let length = u32::from_be_bytes(prefix) as usize;
    if length > MAX_MESSAGE { Err(CodecError::TooLong(length)) } else { Ok(length) }
}

/// Decodes a message without its length prefix; bytes behind it are refused.
pub fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, CodecError> {
    if bytes.len() > MAX_MESSAGE {
        return Err(CodecError::TooLong(bytes.len()));
    }
    let mut rest = bytes;
    let message = ciborium::de::from_reader_with_recursion_limit(&mut rest, MAX_DEPTH)
        .map_err(|error| CodecError::Malformed(error.to_string()))?;
    if !rest.is_empty() {
        return Err(CodecError::Malformed(format!("{} bytes behind the message", rest.len())));
    }
    Ok(message)
}

impl Response {
    /// The response, unless it is a refusal.
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
