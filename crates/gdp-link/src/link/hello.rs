//! The first exchange on a link, with the facts that TLS does not carry.
//!
//! The dialling side sends its hello first. The size of each hello is bounded. The caller bounds
//! the time of the whole exchange.

use super::peer_end::PeerEnd;
use std::net::Ipv4Addr;
use std::time::Duration;

use gdp_wire::{Header, Name};
use quinn::{Connection, RecvStream, SendStream};
use serde::{Deserialize, Serialize};

use super::ids::{LinkId, LinkIds};
use super::negotiation::negotiated;
use super::{Link, RekeySchedule, Versions, streams, tls};
use crate::link::close_code::CloseCode;
use crate::link::error::LinkError;
use crate::link::location::{LinkLocation, PairEnd};
use crate::port::CurrentPair;
use gdp_core::domain::{Credentials, CurrentCredentials, MAX_PAPERS};
use gdp_core::identity::Identity;
use gdp_core::name::NameProof;
use gdp_core::peer::{MAX_LANES, Peer, Role};
use gdp_proto::control;

/// Maximum length of an encoded hello, in bytes. A typical hello has about 100 bytes, or about 1000
/// with a membership.
const MAX_HELLO: usize = MAX_PAPERS + 1024;

/// Largest valid MTU: the payload length has 16 bits.
const MAX_MTU: u32 = Header::LEN as u32 + u16::MAX as u32;

/// Smallest MTU of a usable link, in bytes.
pub const MIN_MTU: u32 = 512;

/// Reason of a close if the exchange took too long, or newer handshakes displaced it.
const ABANDONED: &[u8] = b"the hellos were not exchanged in time; try again";

/// Fields that this version does not know are skipped. What a peer must not skip needs another
/// version.
#[derive(Debug, Serialize, Deserialize)]
struct Hello {
    role: Role,
    /// The inner digest of the sender's name.
    #[serde(with = "gdp_core::cbor::array")]
    digest: [u8; 32],
    /// The id that frames to the sender must carry.
    link_id: u32,
    /// The lane of an endpoint's link. A link with another lane replaces no existing link.
    lane: u8,
    /// Largest data frame that the sender accepts on this link, in bytes.
    mtu: u32,
    /// Whether the sender accepts datagrams over IPv6 without a UDP checksum (RFC 6936).
    zero_checksum: bool,
    /// An endpoint's host id. Present only if its socket accepts datagrams at any IPv4 address of
    /// that host.
    host: Option<u64>,
    /// The link-local IPv4 address to which an endpoint on the switch's host sends frames. Only a
    /// switch sets it. The switch's frames come from that address too, instead of QUIC's address.
    /// The ports are those of QUIC.
    frames_at: Option<[u8; 4]>,
    /// An endpoint's start in Unix nanoseconds. Two running programs with one key differ in it.
    run: Option<u64>,
    /// The shortest interval between echoes that the sender accepts while QUIC is alive, in
    /// milliseconds (compare Required Min Echo RX Interval, RFC 5880). Earlier releases do not
    /// state it, and are sent none.
    echo_ms: Option<u32>,
    /// The sender's credentials, if the sender is a member of a domain. The user of the link
    /// verifies them.
    #[serde(rename = "papers")]
    credentials: Option<Credentials>,
}

/// The contents of this side's hello, and the settings of the resulting link.
#[derive(Clone)]
pub struct HelloConfig {
    pub identity: Identity,
    pub role: Role,
    /// See `Hello::lane`.
    pub lane: u8,
    pub link_ids: LinkIds,
    pub mtu: u32,
    /// See `Hello::zero_checksum`.
    pub zero_checksum: bool,
    /// See `Hello::host`.
    pub host: Option<u64>,
    /// A switch's interface pair for endpoints on its host.
    pub pair: CurrentPair,
    /// See `Hello::run`.
    pub run: Option<u64>,
    /// See `Hello::echo_ms`.
    pub echo_interval: Option<Duration>,
    pub credentials: CurrentCredentials,
    /// The versions that this side speaks.
    pub versions: Versions,
    /// The rekey schedule of the link. The hello does not carry it.
    pub rekey: RekeySchedule,
}

/// Exchanges hellos on a connection that this side dialled. `expected` is the name that the peer
/// must have, if given.
///
/// A peer that refuses the link may close it before this side has read the hello. The error then
/// contains the peer's reason. If this side refuses the link, it closes the connection with a
/// [code](CloseCode) and a reason.
pub async fn greet_as_client(
    connection: Connection,
    location: LinkLocation,
    config: &HelloConfig,
    expected: Option<Name>,
) -> Result<Link, LinkError> {
    let greeted = greet(&connection, say_and_hear(connection.clone(), location, config, expected)).await;
    greeted.map_err(|error| match (error, connection.close_reason()) {
        (LinkError::Closed(_), Some(reason)) => reason.into(),
        (error, _) => error,
    })
}

async fn say_and_hear(
    connection: Connection,
    location: LinkLocation,
    config: &HelloConfig,
    expected: Option<Name>,
) -> Result<Link, LinkError> {
    negotiated(config.versions, &connection)?;
    let (mut send, mut recv) = connection.open_bi().await?;
    let id = config.link_ids.allocate().ok_or(LinkError::NoFreeId)?;
    // Only a peer on this host receives the host id.
    let is_here = || location.leads_to_this_host(connection.remote_address());
    let host = config.host.filter(|_| config.role == Role::Endpoint && is_here());
    say(&mut send, config, (&id, config.mtu), host, None).await?;
    let (peer, peer_end) = hear(&mut recv, &connection).await?;
    if let Some(expected) = expected
        && expected != peer.name
    {
        return Err(LinkError::WrongPeer { expected, found: peer.name });
    }
    let location = match peer_end.frames_at {
        None => location,
        // Only a switch on this host may answer with such an address.
        Some(ip) if host.is_some() && ip.is_link_local() => location.by(PairEnd::toward(ip)),
        Some(ip) => return Err(LinkError::Protocol(format!("{ip} is no place to send frames to"))),
    };
    Link::new(connection, location, (id, config.mtu), peer, peer_end, true, config.rekey)
}

/// Answers the hello of a connection that the peer dialled, or closes it with a
/// [code](CloseCode) and a reason.
pub async fn greet_as_server(
    connection: Connection,
    location: LinkLocation,
    config: &HelloConfig,
) -> Result<Link, LinkError> {
    greet(&connection, hear_and_say(connection.clone(), location, config)).await
}

/// Runs the exchange of hellos. Closes the connection with the reason if this side refuses the
/// link.
async fn greet(
    connection: &Connection,
    exchange: impl Future<Output = Result<Link, LinkError>>,
) -> Result<Link, LinkError> {
    let mut unfinished = Unfinished(Some(connection.clone()));
    let greeted = exchange.await;
    unfinished.0 = None;
    if let Some((code, reason)) = greeted.as_ref().err().and_then(LinkError::refusal) {
        connection.close(code.into(), reason.as_bytes());
    }
    greeted
}

/// Connection of an exchange that its caller may abandon.
struct Unfinished(Option<Connection>);

impl Drop for Unfinished {
    fn drop(&mut self) {
        if let Some(connection) = self.0.take() {
            connection.close(CloseCode::Timeout.into(), ABANDONED);
        }
    }
}

/// This side allocates no link id before the peer has proved its name.
async fn hear_and_say(connection: Connection, location: LinkLocation, config: &HelloConfig) -> Result<Link, LinkError> {
    negotiated(config.versions, &connection)?;
    let (mut send, mut recv) = connection.accept_bi().await?;
    let (peer, peer_end) = hear(&mut recv, &connection).await?;
    let id = config.link_ids.allocate().ok_or(LinkError::NoFreeId)?;
    let pair = config.pair.get().filter(|_| is_on_this_host(config, &connection, &peer, &peer_end));
    // QUIC's path is another one, so it does not discover the pair's MTU.
    let mtu = pair.map_or(config.mtu, |pair| config.mtu.min(pair.mtu));
    say(&mut send, config, (&id, mtu), None, pair.map(|pair| pair.switch_ip)).await?;
    let location = pair.map_or(location, |pair| location.by(PairEnd::of_switch(&pair)));
    Link::new(connection, location, (id, mtu), peer, peer_end, false, config.rekey)
}

/// Returns whether the peer is an endpoint on this host. The peer's hello claims it. The check
/// requires that packets come from the address they go to: the kernel accepts such packets only
/// from its own host.
fn is_on_this_host(config: &HelloConfig, connection: &Connection, peer: &Peer, peer_end: &PeerEnd) -> bool {
    let from = connection.remote_address().ip().to_canonical();
    peer.role == Role::Endpoint
        && peer_end.host.is_some()
        && peer_end.host == config.host
        && connection.local_ip().is_some_and(|local| local.to_canonical() == from)
}

async fn say(
    send: &mut SendStream,
    config: &HelloConfig,
    (id, mtu): (&LinkId, u32),
    host: Option<u64>,
    frames_at: Option<Ipv4Addr>,
) -> Result<(), LinkError> {
    let hello = Hello {
        role: config.role,
        digest: config.identity.proof().digest,
        link_id: id.get(),
        lane: config.lane,
        mtu,
        zero_checksum: config.zero_checksum,
        host,
        frames_at: frames_at.map(|ip| ip.octets()),
        run: config.run,
        echo_ms: config.echo_interval.and_then(|interval| interval.as_millis().try_into().ok()),
        credentials: config.credentials.get().map(|credentials| Credentials::clone(&credentials)),
    };
    streams::write_message(send, &control::encode(&hello)?).await
}

impl Hello {
    /// Returns an error if a field is out of bounds.
    fn check(&self) -> Result<(), LinkError> {
        if self.link_id == 0 {
            return Err(LinkError::Protocol("0 is no link id".into()));
        }
        if usize::from(self.lane) >= MAX_LANES || (self.role == Role::Switch && self.lane != 0) {
            return Err(LinkError::Protocol(format!("{} is no number of a link of {:?}", self.lane, self.role)));
        }
        if !(MIN_MTU..=MAX_MTU).contains(&self.mtu) {
            return Err(LinkError::Protocol(format!("an MTU of {} bytes, not {MIN_MTU} to {MAX_MTU}", self.mtu)));
        }
        Ok(())
    }
}

/// Reads the peer's hello, and returns the peer and its end of the link.
async fn hear(recv: &mut RecvStream, connection: &Connection) -> Result<(Peer, PeerEnd), LinkError> {
    let bytes = streams::read_message(recv, MAX_HELLO).await?;
    let hello: Hello = control::decode(&bytes)?;
    hello.check()?;
    let key = tls::peer_key(connection)?;
    let proof = NameProof { owner_key: *key.as_bytes(), digest: hello.digest };
    let name = gdp_core::name::derive(&proof.owner_key, &proof.digest);
    let Hello { role, lane, link_id: id, mtu, zero_checksum, host, frames_at, run, echo_ms, credentials, .. } = hello;
    let (frames_at, echo_interval) =
        (frames_at.map(Ipv4Addr::from), echo_ms.map(|millis| Duration::from_millis(millis.into())));
    let end = PeerEnd { id, mtu, zero_checksum, host, frames_at, run, echo_interval, credentials };
    Ok((Peer { name, proof, key, role, lane }, end))
}

#[cfg(test)]
#[path = "../../tests/unit/link/hello.rs"]
mod tests;
