//! The sockets of an Ethernet interface or a UDP address, on which links are made.
//!
//! A port owns the sockets, the QUIC endpoint on one of them, and the [`DataSocket`] for data
//! frames. A switch opens one port per interface, an endpoint opens one.
//!
//! A port answers QUIC handshakes and discovery, which require no trust. The caller gets a [`Link`]
//! after the peer has proved its name, and decides whether to accept it.

mod addr;
mod batch;
mod frame_queue;
mod handshakes;
mod host;
mod interface;
#[cfg(target_os = "linux")]
mod linux;
#[cfg(any(test, not(target_os = "linux")))]
#[cfg_attr(target_os = "linux", allow(dead_code, unused_imports, reason = "Linux has it for its tests"))]
mod portable;

#[cfg(target_os = "linux")]
use linux as platform;
#[cfg(not(target_os = "linux"))]
use portable as platform;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use gdp_wire::{ControlHeader, Header, Name, SMALLEST_PATH};
use quinn::{AsyncUdpSocket, Endpoint, EndpointConfig, Incoming, ServerConfig, TokioRuntime};
use tokio::sync::{Mutex, mpsc};
use tokio::task::JoinHandle;
use tokio::time::{Instant, timeout};

use crate::link;
use crate::link::{
    CloseCode, HANDSHAKE_TIMEOUT, HelloConfig, Link, LinkError, LinkIds, LinkLocation, QuicConfigs, QuicMtu,
    RekeySchedule, Versions, greet_as_client, greet_as_server,
};
use gdp_core::domain::CurrentCredentials;
use gdp_core::identity::Identity;
use gdp_core::peer::Role;

pub use addr::LinkAddr;
pub use batch::{BATCH, InFrame, OutFrame, RecvBatch, Sent, UDP_MTU, min_udp_mtu};
pub use handshakes::{HandshakeCounters, HandshakeCounts};
use handshakes::{Handshakes, MAX_HANDSHAKES, Verdict};
pub(crate) use host::CurrentPair;
pub use host::HostPair;
pub use interface::{Interface, Vlan};
use platform::SharedUdp;
pub use platform::ethernet::index_of as interface_index;
use platform::ethernet::{self, ControlSocket};
pub use platform::{DataSocket, WakeEvent};
pub(crate) use platform::{limit_unsent, set_buffers};

/// Largest QUIC packet on Ethernet. Control traffic does not gain from larger packets, and some
/// devices do not pass jumbo frames.
const MAX_ETHERNET_QUIC: u32 = 1472;

/// Smallest Ethernet MTU that QUIC supports, with the control header.
pub const MIN_ETHERNET_MTU: u32 = SMALLEST_PATH as u32 + ControlHeader::LEN as u32;

/// The configuration of a port.
#[derive(Clone)]
pub struct PortConfig {
    /// The entity that the port's links belong to.
    pub identity: Identity,
    pub role: Role,
    /// Shared by all ports of an entity.
    pub link_ids: LinkIds,
    /// The lane of an endpoint's links on this port.
    pub lane: u8,
    /// The interface that a UDP port is bound to.
    pub through: Option<String>,
    /// Whether peers may dial in. On Ethernet, peers can then also discover this port.
    pub listen: bool,
    /// Ethertype of GDP frames.
    pub ethertype: u16,
    /// The rekey schedule of data frames.
    pub rekey: RekeySchedule,
    /// Start of this program in Unix nanoseconds, the same for all ports of an endpoint.
    pub run: Option<u64>,
    /// The domain credentials that new links send to their peers. Shared by all ports of an entity.
    pub credentials: CurrentCredentials,
    /// Counters of inbound handshakes. Shared by all ports of an entity.
    pub handshakes: HandshakeCounters,
}

impl PortConfig {
    /// Returns the configuration for a switch: peers dial in and discover it.
    pub fn switch(identity: Identity, link_ids: LinkIds) -> Self {
        Self { listen: true, ..Self::new(identity, Role::Switch, link_ids) }
    }

    /// Returns the configuration for an endpoint: it only dials out.
    pub fn endpoint(identity: Identity) -> Self {
        Self::new(identity, Role::Endpoint, LinkIds::new())
    }

    fn new(identity: Identity, role: Role, link_ids: LinkIds) -> Self {
        let (ethertype, rekey) = (gdp_wire::ETHERTYPE, RekeySchedule::default());
        let (credentials, handshakes) = (CurrentCredentials::default(), HandshakeCounters::default());
        Self {
            identity,
            role,
            lane: 0,
            through: None,
            link_ids,
            listen: false,
            ethertype,
            rekey,
            run: None,
            credentials,
            handshakes,
        }
    }
}

/// An open port. Dropping it closes its links.
pub struct Port {
    endpoint: Endpoint,
    /// The socket of `endpoint`.
    socket: Arc<dyn AsyncUdpSocket>,
    quic: Arc<QuicConfigs>,
    hello: HelloConfig,
    medium: Medium,
    data: Arc<DataSocket>,
    accepted: Mutex<mpsc::Receiver<Result<Link, LinkError>>>,
    acceptor: Option<JoinHandle<()>>,
}

#[derive(Clone)]
enum Medium {
    Ethernet(Interface, Arc<ControlSocket>),
    Udp(SocketAddr, Arc<SharedUdp>),
}

impl Interface {
    /// Looks up an Ethernet interface by name in the network namespace of the calling thread.
    ///
    /// # Errors
    ///
    /// Fails if there is no such interface, and on all systems but Linux.
    pub fn find(name: &str) -> std::io::Result<Self> {
        ethernet::find(name)
    }
}

impl Port {
    /// Opens a port on an Ethernet interface of the calling thread's network namespace. Requires
    /// CAP_NET_RAW, and Linux. Call within a tokio runtime.
    pub fn ethernet(interface: &str, config: &PortConfig) -> Result<Self, LinkError> {
        let fail = |what: &str| {
            let what = format!("interface {interface}: {what}");
            move |source| LinkError::Io { what, source }
        };
        let found = Interface::find(interface).map_err(fail("cannot be used"))?;
        if found.mtu < MIN_ETHERNET_MTU {
            let what = format!("interface {interface}: its MTU of {} is below {MIN_ETHERNET_MTU}", found.mtu);
            return Err(LinkError::Io { what, source: std::io::ErrorKind::InvalidInput.into() });
        }
        let answer_as = config.listen.then(|| config.identity.name());
        let opening = "no packet socket (needs root or CAP_NET_RAW; without it, use a UDP link)";
        let control = ControlSocket::open(&found, config.ethertype, answer_as).map_err(fail(opening))?;
        let control = Arc::new(control);
        let data = DataSocket::ethernet(&found, config.ethertype).map_err(fail(opening))?;
        let frame_mtu = found.mtu.min(Header::LEN as u32 + u16::MAX as u32);
        Self::open(config, control.clone(), Medium::Ethernet(found, control), data, frame_mtu)
    }

    /// Opens a port on a UDP address. Call within a tokio runtime.
    pub fn udp(bind: SocketAddr, config: &PortConfig) -> Result<Self, LinkError> {
        let through = config.through.as_ref().map_or(String::new(), |interface| format!(" to interface {interface}"));
        let fail = |source| LinkError::Io { what: format!("cannot bind UDP {bind}{through}"), source };
        let socket = Arc::new(SharedUdp::bind(bind, config.through.as_deref()).map_err(fail)?);
        let data = DataSocket::udp(socket.clone());
        let medium = Medium::Udp(socket.local_addr().map_err(fail)?, socket.clone());
        Self::open(config, socket, medium, data, UDP_MTU)
    }

    fn open(
        config: &PortConfig,
        socket: Arc<dyn AsyncUdpSocket>,
        medium: Medium,
        data: DataSocket,
        frame_mtu: u32,
    ) -> Result<Self, LinkError> {
        // A station does not change its MAC address within a link.
        let quic = Arc::new(QuicConfigs::new(config.identity.key(), Versions::SPOKEN, medium.is_udp())?);
        let mut endpoint_config = EndpointConfig::default();
        // The QUIC bit distinguishes QUIC packets from data frames on a shared port.
        endpoint_config.grease_quic_bit(false);
        let setup_error = |error| LinkError::Io { what: "QUIC endpoint".into(), source: std::io::Error::other(error) };
        endpoint_config.max_udp_payload_size(medium.largest_quic()).map_err(setup_error)?;
        // [`accept_one`] has the configuration of each connection.
        let server = config.listen.then(|| quic.server(QuicMtu { initial: SMALLEST_PATH, discover_up_to: None }));
        let endpoint =
            Endpoint::new_with_abstract_socket(endpoint_config, server, socket.clone(), Arc::new(TokioRuntime))
                .map_err(|source| LinkError::Io { what: "QUIC endpoint".into(), source })?;
        let hello = HelloConfig {
            identity: config.identity.clone(),
            role: config.role,
            lane: config.lane,
            link_ids: config.link_ids.clone(),
            mtu: frame_mtu,
            rekey: config.rekey,
            zero_checksum: medium.udp().is_some_and(|socket| socket.takes_zero_checksums()),
            host: medium.udp().and_then(|socket| socket.host()),
            pair: CurrentPair::default(),
            run: config.run,
            echo_interval: Some(link::liveness::MIN_INTERVAL),
            credentials: config.credentials.clone(),
            versions: Versions::SPOKEN,
        };
        let (sender, accepted) = mpsc::channel(MAX_HANDSHAKES);
        let accepting = || {
            accept_all(endpoint.clone(), quic.clone(), hello.clone(), medium.clone(), config.handshakes.clone(), sender)
        };
        let acceptor = config.listen.then(|| tokio::spawn(accepting()));
        Ok(Self {
            endpoint,
            socket,
            quic: quic.clone(),
            hello,
            medium,
            data: Arc::new(data),
            accepted: Mutex::new(accepted),
            acceptor,
        })
    }

    /// Makes a link to the peer at `to`. Refuses a peer with another name than `expected`, if
    /// given.
    pub async fn dial(&self, to: LinkAddr, expected: Option<Name>) -> Result<Link, LinkError> {
        self.dial_as(to, expected, &self.hello).await
    }

    /// Makes a link as [`Self::dial`] does, but without a [`HostPair`]. Frames pass through the
    /// switch's daemon even if that switch is on this host.
    pub async fn dial_apart(&self, to: LinkAddr, expected: Option<Name>) -> Result<Link, LinkError> {
        self.dial_as(to, expected, &HelloConfig { host: None, ..self.hello.clone() }).await
    }

    async fn dial_as(&self, to: LinkAddr, expected: Option<Name>, hello: &HelloConfig) -> Result<Link, LinkError> {
        let address = match (to, &self.medium) {
            (LinkAddr::Ethernet { ifindex, mac }, Medium::Ethernet(interface, _)) if ifindex == interface.index => {
                addr::mac_to_socket(mac)
            }
            (LinkAddr::Udp(addr), Medium::Udp(..)) => addr,
            _ => return Err(LinkError::Handshake(format!("{to} cannot be reached through this port"))),
        };
        let handshake = async {
            let connecting = self
                .endpoint
                .connect_with(self.quic.client(self.medium.quic_mtu(address)), address, link::SERVER_NAME)
                .map_err(|error| LinkError::Handshake(format!("{to}: {error}")))?;
            let connection = connecting.await.map_err(|error| {
                let error = link::close_reason(&error);
                LinkError::Handshake(format!("no answer from {to} that is one of a peer: {error}"))
            })?;
            let location = self.medium.location(&connection);
            greet_as_client(connection, location, hello, expected).await
        };
        timeout(HANDSHAKE_TIMEOUT, handshake)
            .await
            .unwrap_or(Err(LinkError::Timeout { what: "the handshake", after: HANDSHAKE_TIMEOUT }))
    }

    /// Returns the next link that a peer made, or the error of a failed handshake; `None` after the
    /// port has closed. Handshakes run concurrently, even if no task calls this function. Their
    /// number and duration are bounded.
    pub async fn accept(&self) -> Option<Result<Link, LinkError>> {
        self.accepted.lock().await.recv().await
    }

    /// Discovers the switches on the segment, or only the switch named `wanted`. Stops after
    /// `within`, or when answers stop arriving. Answers are not authenticated: dialling verifies
    /// them, and several may claim one name. Returns nothing on UDP.
    pub async fn discover(&self, wanted: Option<Name>, within: Duration) -> Vec<(LinkAddr, Name)> {
        match &self.medium {
            Medium::Ethernet(_, control) => control.discover(wanted, within).await,
            Medium::Udp(..) => Vec::new(),
        }
    }

    /// Notifies all peers of this side's current address, after the addresses of this machine have
    /// changed. Otherwise a peer would send to the old address until this side's next packet.
    pub fn show_address(&self) -> Result<(), LinkError> {
        let rebound = self.endpoint.rebind_abstract(self.socket.clone());
        rebound.map_err(|source| LinkError::Io { what: "QUIC endpoint".into(), source })
    }

    /// Returns the socket for data frames of this port's links.
    pub fn data(&self) -> Arc<DataSocket> {
        self.data.clone()
    }

    /// Returns the interface of an Ethernet port.
    pub fn interface(&self) -> Option<&Interface> {
        match &self.medium {
            Medium::Ethernet(interface, _) => Some(interface),
            Medium::Udp(..) => None,
        }
    }

    /// Returns the address that a UDP port is bound to.
    pub fn udp_addr(&self) -> Option<SocketAddr> {
        match &self.medium {
            Medium::Ethernet(..) => None,
            Medium::Udp(..) => self.endpoint.local_addr().ok(),
        }
    }

    /// Sets the interface pair for frames of endpoints on this host that dial in from now on. With
    /// `None`, their frames pass through the daemon.
    pub fn set_host_pair(&self, pair: Option<HostPair>) {
        self.hello.pair.set(pair);
    }

    /// Returns the size of the largest data frame that fits this port's links, in bytes.
    pub fn mtu(&self) -> u32 {
        self.hello.mtu
    }

    /// Returns the size of the largest data frame that the kernel's route to a peer takes, in
    /// bytes.
    pub fn route_mtu(&self, to: LinkAddr) -> u32 {
        match (&self.medium, to) {
            (Medium::Udp(_, socket), LinkAddr::Udp(to)) => socket.mtu_upper_bound(to).into(),
            _ => self.mtu(),
        }
    }

    /// Closes all links with this reason, and waits at most 1 s for the close messages.
    pub async fn close(&self, reason: &str) {
        self.endpoint.close(CloseCode::Ended.into(), reason.as_bytes());
        let _ = timeout(Duration::from_secs(1), self.endpoint.wait_idle()).await;
    }
}

impl Drop for Port {
    fn drop(&mut self) {
        if let Some(acceptor) = &self.acceptor {
            acceptor.abort();
        }
        self.endpoint.close(CloseCode::Ended.into(), b"port closed");
    }
}

impl Medium {
    fn location(&self, connection: &quinn::Connection) -> LinkLocation {
        match self {
            Self::Ethernet(interface, _) => LinkLocation::Ethernet {
                ifindex: interface.index,
                vlan: interface.vlan.as_ref().map_or(0, |vlan| vlan.id),
                local_mac: interface.mac,
                peer_mac: addr::socket_to_mac(&connection.remote_address()),
            },
            Self::Udp(bound, _) => LinkLocation::Udp { bound: *bound, pair: None },
        }
    }

    fn is_udp(&self) -> bool {
        self.udp().is_some()
    }

    fn udp(&self) -> Option<&SharedUdp> {
        match self {
            Self::Ethernet(..) => None,
            Self::Udp(_, socket) => Some(socket),
        }
    }

    /// Returns the size of the largest QUIC packet that this side takes, in bytes.
    fn largest_quic(&self) -> u16 {
        match self {
            Self::Ethernet(interface, _) => (interface.mtu - ControlHeader::LEN as u32).min(MAX_ETHERNET_QUIC) as u16,
            Self::Udp(..) => UDP_MTU as u16,
        }
    }

    /// Returns the path MTU of a connection to a peer.
    fn quic_mtu(&self, to: SocketAddr) -> QuicMtu {
        match self {
            Self::Ethernet(..) => QuicMtu { initial: self.largest_quic(), discover_up_to: None },
            Self::Udp(_, socket) => {
                QuicMtu { initial: SMALLEST_PATH, discover_up_to: Some(socket.mtu_upper_bound(to)) }
            }
        }
    }
}

async fn accept_all(
    endpoint: Endpoint,
    quic: Arc<QuicConfigs>,
    hello: HelloConfig,
    medium: Medium,
    counters: HandshakeCounters,
    sender: mpsc::Sender<Result<Link, LinkError>>,
) {
    let handshakes = Handshakes::new(counters.clone());
    while let Some(incoming) = endpoint.accept().await {
        let from = incoming.remote_address();
        let started = match handshakes.admit(Instant::now(), from.ip(), medium.is_udp() && incoming.may_retry()) {
            Verdict::Ignore => {
                incoming.ignore();
                continue;
            }
            Verdict::Challenge => {
                let _ = incoming.retry();
                continue;
            }
            Verdict::Start(started) => Arc::new(started),
        };
        let (hello, medium, sender, counters) = (hello.clone(), medium.clone(), sender.clone(), counters.clone());
        let server = quic.server(medium.quic_mtu(from));
        let counted = started.clone();
        let task = tokio::spawn(async move {
            let link = timeout(HANDSHAKE_TIMEOUT, accept_one(incoming, server, &hello, &medium))
                .await
                .unwrap_or(Err(LinkError::Timeout { what: "the handshake of a peer", after: HANDSHAKE_TIMEOUT }));
            if let Err(error) = &link {
                counters.count_failed();
                tracing::debug!(%from, %error, "a handshake failed");
            }
            let _ = sender.send(link).await;
            // Dropped only after the link was accepted: links that wait for [`Port::accept`] count
            // as well.
            drop(counted);
        });
        started.runs_as(task.abort_handle());
    }
}

async fn accept_one(
    incoming: Incoming,
    server: ServerConfig,
    hello: &HelloConfig,
    medium: &Medium,
) -> Result<Link, LinkError> {
    let failed = |error| LinkError::Handshake(link::close_reason(&error));
    let connection = incoming.accept_with(Arc::new(server)).map_err(failed)?.await.map_err(failed)?;
    let location = medium.location(&connection);
    greet_as_server(connection, location, hello).await
}
