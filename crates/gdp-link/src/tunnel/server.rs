//! The side of tunnels that listens: a switch. Each tunnel has a loopback socket of its own, which
//! is connected to the switch's UDP port.

use std::hash::{BuildHasher, RandomState};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;
use std::{fs, io};

use gdp_util::descriptors::is_reserved;
use parking_lot::Mutex;
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::net::{TcpListener, TcpStream, UdpSocket};
use tokio::task::JoinSet;
use tokio::time::{sleep, timeout};
use tokio_rustls::TlsAcceptor;
use tokio_tungstenite::accept_async_with_config;

use super::admission::{Admission, MAX_OPENING, MAX_OPENING_OF_ONE, MAX_TUNNELS, MAX_TUNNELS_OF_ONE, source_of};
use super::framing::{FIRST_WEBSOCKET_BYTE, Incoming, Outgoing, by_length, by_message, websocket_config};
use super::peers::TunnelPeers;
use super::{LOOPBACK_BUFFER, credentials, pump, stream};
use crate::port::set_buffers;

/// Maximum time from a TCP connection to the first datagram's framing.
const OPENING: Duration = Duration::from_secs(5);

/// Pause after an error of the listening socket, such as too many open files.
const ACCEPT_AGAIN: Duration = Duration::from_millis(100);

/// The first of the loopback addresses that stand for peers, and the number of bits that differ.
/// Each source has an address of its own, so the limits per address hold for tunnels too.
const FIRST_LOCAL: Ipv4Addr = Ipv4Addr::new(127, 64, 0, 0);
const LOCAL_BITS: u32 = 22;

/// Accepts tunnels for a switch.
pub struct TlsListener {
    tcp: TcpListener,
    tls: TlsAcceptor,
}

struct Tunnels {
    tls: TlsAcceptor,
    /// Address of the switch's UDP port.
    switch: SocketAddr,
    admission: Mutex<Admission>,
    /// The connections that are being opened.
    opening: Mutex<Admission>,
    peers: TunnelPeers,
    /// Makes loopback addresses that peers cannot choose.
    hasher: RandomState,
}

impl TlsListener {
    /// Listens at `addr`, without accepting connections yet.
    pub async fn bind(addr: SocketAddr) -> io::Result<Self> {
        let tls = TlsAcceptor::from(Arc::new(credentials::server().map_err(io::Error::other)?));
        Ok(Self { tcp: TcpListener::bind(addr).await?, tls })
    }

    pub fn local_addr(&self) -> io::Result<SocketAddr> {
        self.tcp.local_addr()
    }

    /// Runs tunnels to the switch with this UDP address, and shows their peers in `peers`. Dropping
    /// the future ends them.
    pub async fn run(self, switch: SocketAddr, peers: TunnelPeers) {
        let admission = Mutex::new(Admission::new(MAX_TUNNELS, MAX_TUNNELS_OF_ONE));
        let opening = Mutex::new(Admission::new(MAX_OPENING, MAX_OPENING_OF_ONE));
        let hasher = RandomState::new();
        let tunnels = Arc::new(Tunnels { tls: self.tls, switch, admission, opening, peers, hasher });
        let mut running = JoinSet::new();
        loop {
            while running.try_join_next().is_some() {}
            let (tcp, peer) = match self.tcp.accept().await {
                Ok(accepted) => accepted,
                Err(error) => {
                    tracing::debug!(%error, "no TLS connection is accepted for now");
                    sleep(ACCEPT_AGAIN).await;
                    continue;
                }
            };
            let peer = SocketAddr::new(peer.ip().to_canonical(), peer.port());
            let admitted = Admitted::new(&tunnels, source_of(peer.ip()));
            let Some(admitted) = admitted.filter(|_| !is_reserved(&tcp)) else {
                tracing::debug!(%peer, "a TLS connection is closed: there are too many");
                continue;
            };
            running.spawn(async move {
                if let Err(error) = admitted.serve(tcp, peer).await {
                    tracing::debug!(%peer, %error, "a TLS connection has ended");
                }
            });
        }
    }
}

/// A connection that counts until this value is dropped.
struct Admitted {
    tunnels: Arc<Tunnels>,
    source: IpAddr,
}

impl Admitted {
    fn new(tunnels: &Arc<Tunnels>, source: IpAddr) -> Option<Self> {
        tunnels.admission.lock().admit(source).then(|| Self { tunnels: tunnels.clone(), source })
    }

    async fn serve(self, tcp: TcpStream, peer: SocketAddr) -> io::Result<()> {
        stream::prepare(&tcp)?;
        if !self.tunnels.opening.lock().admit(self.source) {
            return Err(io::Error::other("too many connections are being opened"));
        }
        let opened = timeout(OPENING, self.open(tcp)).await;
        self.tunnels.opening.lock().release(self.source);
        let datagrams = opened??;
        let (from, switch) = self.tunnels.path(self.source);
        let socket = UdpSocket::bind((from, 0)).await?;
        set_buffers(&socket, LOOPBACK_BUFFER, LOOPBACK_BUFFER);
        socket.connect(switch).await?;
        let listed = ListedPeer { peers: &self.tunnels.peers, local: socket.local_addr()? };
        listed.peers.add(listed.local, peer);
        pump::run(datagrams, socket).await
    }

    /// Returns the datagrams of a connection, whose first byte shows their framing.
    async fn open(&self, tcp: TcpStream) -> io::Result<(Incoming, Outgoing)> {
        let mut stream = BufReader::new(self.tunnels.tls.accept(tcp).await?);
        match stream.fill_buf().await?.first() {
            Some(&FIRST_WEBSOCKET_BYTE) => {
                let accepted = accept_async_with_config(stream, Some(websocket_config())).await;
                Ok(by_message(accepted.map_err(io::Error::other)?))
            }
            Some(_) => Ok(by_length(stream)),
            None => Err(io::ErrorKind::UnexpectedEof.into()),
        }
    }
}

impl Drop for Admitted {
    fn drop(&mut self) {
        self.tunnels.admission.lock().release(self.source);
    }
}

/// An entry of the peers, until it is dropped.
struct ListedPeer<'a> {
    peers: &'a TunnelPeers,
    local: SocketAddr,
}

impl Drop for ListedPeer<'_> {
    fn drop(&mut self) {
        self.peers.remove(self.local);
    }
}

impl Tunnels {
    /// Returns the address to send from for a source, and the address of the switch. IPv6 has one
    /// loopback address, so a switch that takes no IPv4 sees all peers at one address.
    fn path(&self, source: IpAddr) -> (IpAddr, SocketAddr) {
        let mut switch = self.switch;
        if switch.ip().is_unspecified() {
            let is_v4 = switch.is_ipv4() || !only_v6();
            switch.set_ip(if is_v4 { Ipv4Addr::LOCALHOST.into() } else { Ipv6Addr::LOCALHOST.into() });
        }
        let number = self.hasher.hash_one(source) as u32 & ((1 << LOCAL_BITS) - 1);
        let from = match switch.ip() {
            IpAddr::V4(_) => Ipv4Addr::from_bits(FIRST_LOCAL.to_bits() | number).into(),
            own => own,
        };
        (from, switch)
    }
}

/// Returns whether sockets at `[::]` take no IPv4 on this host.
fn only_v6() -> bool {
    fs::read_to_string("/proc/sys/net/ipv6/bindv6only").is_ok_and(|text| text.trim() == "1")
}

#[cfg(test)]
#[path = "../../tests/unit/tunnel/server.rs"]
mod tests;
