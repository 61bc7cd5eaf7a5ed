//! An authenticated adjacency of two entities.
//!
//! A link is a QUIC connection that carries requests in both directions. The ids, keys and MTU of
//! the link's data frames follow from that connection. [`crate::port`] makes links; data frames do
//! not pass through this module.
//!
//! After the TLS handshake, the dialling side opens a stream and sends its [`Hello`](hello). The
//! other side answers with its own. A peer's name is derived from the key it proved in TLS and the
//! digest in its hello. The peer therefore cannot claim another entity's name.

mod close_code;
mod error;
mod hello;
mod ids;
mod keyed_entry;
pub mod liveness;
mod location;
mod negotiation;
mod peer_end;
mod ratchet;
mod rekey;
mod streams;
mod timing;
mod tls;
mod version;

pub use crate::link::close_code::CloseCode;
pub use crate::link::error::LinkError;
pub(crate) use crate::link::error::close_reason;
pub(crate) use crate::link::location::LinkLocation;
use crate::link::location::udp_source;
use liveness::Pace;
use timing::MAX_STREAMS;
pub use timing::{HANDSHAKE_TIMEOUT, IDLE_TIMEOUT, KEEP_ALIVE, REQUEST_TIMEOUT};

use std::fmt;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use gdp_wire::table::ip_words;
use gdp_wire::{Carrier, LinkEntry, LinkRole};
use parking_lot::Mutex as StdMutex;
use tokio::sync::{Mutex, mpsc};
use tokio::task::JoinHandle;
use zeroize::Zeroizing;

use crate::port::LinkAddr;
use gdp_core::domain::Credentials;
use gdp_core::peer::{Peer, Role};
use gdp_proto::control::{Request, Response};

pub use ids::{LinkId, LinkIds};
pub use keyed_entry::KeyedEntry;
pub use ratchet::{LinkKeys, RekeySchedule};
pub use streams::Responder;

use crate::link::peer_end::PeerEnd;
use crate::link::streams::{Announcement, MAX_ANNOUNCEMENTS};
use ratchet::Ratchet;

pub use hello::MIN_MTU;
pub(crate) use hello::{HelloConfig, greet_as_client, greet_as_server};
pub(crate) use tls::{QuicConfigs, QuicMtu, SERVER_NAME};
pub(crate) use version::Versions;

/// One link. All clones refer to the same link, which closes when the last clone is dropped.
#[derive(Clone)]
pub struct Link(Arc<Inner>);

struct Inner {
    peer: Peer,
    local_id: LinkId,
    peer_id: u32,
    ratchet: StdMutex<Ratchet>,
    announcements: Mutex<mpsc::Receiver<Announcement>>,
    mtu: u32,
    /// The limit of the route to the peer; see [`Link::limit_mtu`].
    mtu_limit: AtomicU32,
    /// Whether the peer accepts datagrams over IPv6 without a UDP checksum.
    zero_checksum: bool,
    location: LinkLocation,
    connection: quinn::Connection,
    requests: Mutex<mpsc::Receiver<(Request, Responder)>>,
    streams: JoinHandle<()>,
    /// See `Hello::run`.
    peer_run: Option<u64>,
    /// See `Hello::echo_ms`.
    echo_interval: Option<Duration>,
    credentials: StdMutex<Option<Arc<Credentials>>>,
    /// The reason for which this side closed the link.
    closed_for: OnceLock<String>,
}

impl Link {
    /// Derives the keys of data frames from a connection after both hellos, and starts to accept
    /// requests.
    pub(crate) fn new(
        connection: quinn::Connection,
        location: LinkLocation,
        local: (LinkId, u32),
        peer: Peer,
        peer_end: PeerEnd,
        dialled: bool,
        schedule: RekeySchedule,
    ) -> Result<Self, LinkError> {
        let to_server = export_secret(&connection, b"client to server")?;
        let to_client = export_secret(&connection, b"server to client")?;
        let (rx, tx) = if dialled { (to_client, to_server) } else { (to_server, to_client) };
        let ratchet = Ratchet::new(rx, tx, schedule, Instant::now())
            .map_err(|error| LinkError::Handshake(format!("no keys can be derived: {error}")))?;
        let (sender, requests) = mpsc::channel(MAX_STREAMS as usize);
        let (announced, announcements) = mpsc::channel(MAX_ANNOUNCEMENTS);
        let streams = tokio::spawn(streams::serve(
            connection.clone(),
            streams::Takers { requests: sender, announcements: announced },
        ));
        Ok(Self(Arc::new(Inner {
            peer,
            local_id: local.0,
            peer_id: peer_end.id,
            ratchet: StdMutex::new(ratchet),
            announcements: Mutex::new(announcements),
            mtu: local.1.min(peer_end.mtu),
            mtu_limit: AtomicU32::new(u32::MAX),
            zero_checksum: peer_end.zero_checksum,
            location,
            connection,
            requests: Mutex::new(requests),
            streams,
            peer_run: peer_end.run,
            echo_interval: peer_end.echo_interval,
            credentials: StdMutex::new(peer_end.credentials.map(Arc::new)),
            closed_for: OnceLock::new(),
        })))
    }

    pub fn peer(&self) -> &Peer {
        &self.0.peer
    }

    /// Whether another run of the same endpoint's program has `other`. Endpoints of earlier
    /// releases do not state their run.
    pub fn is_of_another_run(&self, other: &Self) -> bool {
        self.0.peer_run.zip(other.0.peer_run).is_some_and(|(own, other)| own != other)
    }

    /// Returns the schedule of echoes while QUIC is alive. Peers of earlier releases negotiate
    /// none, and are sent echoes only after QUIC has fallen silent.
    pub fn negotiated_pace(&self) -> Option<Pace> {
        self.0.echo_interval.map(Pace::negotiated)
    }

    /// Returns the schedule of echoes after QUIC has fallen silent.
    pub fn pace(&self) -> Pace {
        self.negotiated_pace().unwrap_or_else(|| Pace::of(self.addr()))
    }

    /// Returns the credentials that the peer sent for its domain. The link does not verify them.
    pub fn credentials(&self) -> Option<Arc<Credentials>> {
        self.0.credentials.lock().clone()
    }

    /// Replaces the peer's credentials with renewed ones.
    pub fn set_credentials(&self, credentials: Arc<Credentials>) {
        *self.0.credentials.lock() = Some(credentials);
    }

    /// Returns the link id that arriving frames carry.
    pub fn local_id(&self) -> u32 {
        self.0.local_id.get()
    }

    /// Returns the size of the largest data frame, header and payload, in bytes. Over UDP the value
    /// follows QUIC's path MTU discovery.
    pub fn mtu(&self) -> u32 {
        match self.0.location {
            LinkLocation::Ethernet { .. } => self.0.mtu,
            LinkLocation::Udp { .. } => {
                let discovered = self.0.connection.stats().path.current_mtu.into();
                self.0.mtu.min(discovered).min(self.0.mtu_limit.load(Ordering::Relaxed))
            }
        }
    }

    /// Limits data frames over UDP to what the route to the peer takes now, in bytes. After a move,
    /// QUIC keeps the path MTU that it has discovered before.
    pub fn limit_mtu(&self, route: u32) {
        self.0.mtu_limit.store(route, Ordering::Relaxed);
    }

    /// Returns the address that data frames are sent to. A UDP address changes after the peer has
    /// moved and QUIC has validated the new path.
    pub fn addr(&self) -> LinkAddr {
        match self.0.location {
            LinkLocation::Ethernet { ifindex, peer_mac, .. } => LinkAddr::Ethernet { ifindex, mac: peer_mac },
            LinkLocation::Udp { pair: None, .. } => LinkAddr::udp(self.0.connection.remote_address()),
            LinkLocation::Udp { pair: Some(pair), .. } => {
                LinkAddr::udp((pair.peer_ip, self.0.connection.remote_address().port()).into())
            }
        }
    }

    /// Returns whether frames pass through the switch's [`HostPair`].
    pub fn is_by_pair(&self) -> bool {
        matches!(self.0.location, LinkLocation::Udp { pair: Some(_), .. })
    }

    /// Returns the carrier of data frames to the peer. Over UDP it follows the addresses of both
    /// sides.
    pub fn carrier(&self) -> Carrier {
        let inner = &*self.0;
        // An endpoint's kernel joins datagrams with a UDP checksum (GRO). A switch receives frames
        // before its kernel could join them.
        let joins = if inner.peer.role == Role::Endpoint { Carrier::CHECKSUM } else { 0 };
        match inner.location {
            LinkLocation::Ethernet { vlan, local_mac, peer_mac, .. } => {
                Carrier { vlan, ..Carrier::ethernet(peer_mac, local_mac) }
            }
            LinkLocation::Udp { bound, pair: Some(pair) } => Carrier {
                kind: Carrier::UDP4,
                flags: joins,
                peer_port: inner.connection.remote_address().port().to_be(),
                local_port: bound.port().to_be(),
                peer_ip: ip_words(pair.peer_ip.into()).1,
                local_ip: ip_words(pair.local_ip.into()).1,
                ..Carrier::ethernet(pair.peer_mac, pair.local_mac)
            },
            LinkLocation::Udp { bound, pair: None } => {
                let peer = inner.connection.remote_address();
                // Only the dialled side learns its address from the peer's packets.
                let local = inner.connection.local_ip().map(|ip| ip.to_canonical());
                let local = local.unwrap_or_else(|| udp_source(bound.ip(), peer));
                let (kind, peer_ip) = ip_words(peer.ip().to_canonical());
                let (local_kind, local_ip) = ip_words(local);
                Carrier {
                    kind,
                    flags: joins | if inner.zero_checksum { Carrier::ZERO_CHECKSUM } else { 0 },
                    peer_port: peer.port().to_be(),
                    local_port: bound.port().to_be(),
                    peer_ip,
                    // An unknown address is the unspecified address.
                    local_ip: if local_kind == kind { local_ip } else { [0; 4] },
                    ..Carrier::default()
                }
            }
        }
    }

    /// Returns the link's entry for a data plane, with `port` as the key in a device map. The entry
    /// has the current keys; [`Self::keep_keys`] replaces them. A switch fills in `reach`.
    pub fn entry(&self, port: u32) -> LinkEntry {
        let inner = &*self.0;
        let mut entry = LinkEntry {
            id: self.local_id(),
            peer_id: inner.peer_id,
            role: LinkRole::from(inner.peer.role) as u32,
            port,
            peer: inner.peer.name,
            mtu: self.mtu(),
            carrier: self.carrier(),
            lane: inner.peer.lane.into(),
            ..LinkEntry::default()
        };
        self.ratchet().keys().put(&mut entry);
        entry
    }

    /// Returns how often the receive keys and the send keys have been replaced.
    pub fn key_generations(&self) -> (u64, u64) {
        self.ratchet().generations()
    }

    /// Sends a request to the peer and waits at most [`REQUEST_TIMEOUT`] for the response. A
    /// refusal counts as a response.
    pub async fn request(&self, request: &Request) -> Result<Response, LinkError> {
        // The reason of a closed link is more specific than the error of a stream.
        let said = |error| match self.0.connection.close_reason() {
            Some(quinn::ConnectionError::Reset) => LinkError::Reset,
            Some(reason) => LinkError::Closed(self.describe(&reason)),
            None => error,
        };
        streams::request(&self.0.connection, request).await.map_err(said)
    }

    /// Returns the peer's next request, or `None` after the link has closed.
    pub async fn accept_request(&self) -> Option<(Request, Responder)> {
        self.0.requests.lock().await.recv().await
    }

    /// Waits until either side closes the link or the link times out, and returns the reason.
    pub async fn closed(&self) -> String {
        let error = self.0.connection.closed().await;
        self.describe(&error)
    }

    /// Returns why the link is closed, if it is closed.
    pub fn close_reason(&self) -> Option<String> {
        self.0.connection.close_reason().map(|error| self.describe(&error))
    }

    fn describe(&self, error: &quinn::ConnectionError) -> String {
        match (error, self.0.closed_for.get()) {
            (quinn::ConnectionError::LocallyClosed, Some(reason)) => format!("closed on this side: {reason}"),
            _ => close_reason(error),
        }
    }

    /// Returns whether the link timed out or was reset without a close from the peer. The data
    /// planes may then continue to forward the link's frames; see
    /// [`gdp_core::peer::GRACEFUL_RESTART_TIME`].
    pub fn fell_silent(&self) -> bool {
        use quinn::ConnectionError::{Reset, TimedOut};
        matches!(self.0.connection.close_reason(), Some(TimedOut | Reset))
    }

    /// Closes the link without a fault of the peer, and sends the reason to it.
    pub fn close(&self, reason: &str) {
        self.refuse(CloseCode::Ended, reason);
    }

    /// Closes the link with a code for the peer's program and a reason for people.
    pub fn refuse(&self, code: CloseCode, reason: &str) {
        let _ = self.0.closed_for.set(reason.into());
        self.0.connection.close(code.into(), reason.as_bytes());
    }

    /// Returns the round-trip time of the control connection.
    pub fn rtt(&self) -> Duration {
        self.0.connection.rtt()
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        self.streams.abort();
        self.connection.close(CloseCode::Ended.into(), b"no longer in use");
    }
}

impl fmt::Debug for Link {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Link({:#} at {}, id {:#x})", self.0.peer.name, self.addr(), self.local_id())
    }
}

/// Exports the secret of one direction from TLS (RFC 5705). Both sides derive the same secret,
/// which no third party knows.
fn export_secret(connection: &quinn::Connection, context: &[u8]) -> Result<Zeroizing<[u8; 32]>, LinkError> {
    let mut secret = Zeroizing::new([0; 32]);
    connection
        .export_keying_material(secret.as_mut_slice(), b"EXPORTER-gdp-link", context)
        .map_err(|_| LinkError::Handshake("TLS exports no keys".into()))?;
    Ok(secret)
}

#[cfg(test)]
#[path = "../tests/unit/link.rs"]
mod tests;
