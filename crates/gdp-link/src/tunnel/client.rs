//! The side of a tunnel that dials: an endpoint or a relay.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use hyper_util::client::proxy::matcher::Matcher;
use rustls::pki_types::ServerName;
use tokio::net::{TcpStream, UdpSocket};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::timeout;
use tokio_rustls::TlsConnector;
use tokio_tungstenite::client_async_with_config;

use super::framing::{Incoming, Outgoing, by_length, by_message, websocket_config};
use super::http_proxy::{HttpProxy, HttpProxyError};
use super::{LOOPBACK_BUFFER, credentials, pump, stream};
use crate::port::set_buffers;

/// Maximum time until a tunnel is open.
const OPENING: Duration = Duration::from_secs(5);

/// Maximum time for one of a host's addresses.
const ONE_ADDRESS: Duration = Duration::from_millis(1500);

/// The reason why a tunnel could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum TunnelError {
    #[error("no TCP connection to {to}: {source}; does a switch listen there with `tls:`, and is the port open?")]
    Tcp { to: String, source: io::Error },
    #[error("no TCP connection to the HTTP proxy {proxy}: {source}; check HTTPS_PROXY")]
    ProxyTcp { proxy: String, source: io::Error },
    #[error("the HTTP proxy {proxy}: {source}")]
    Proxy { proxy: String, source: HttpProxyError },
    #[error("HTTPS_PROXY: {0}")]
    NoProxy(#[from] HttpProxyError),
    #[error("{to} does not speak TLS 1.3 as a switch does: {source}")]
    Tls { to: String, source: io::Error },
    #[error("{to} takes no WebSocket: {reason}")]
    WebSocket { to: String, reason: String },
    #[error("{to} did not answer over TLS for {} s; is TCP to it blocked?", OPENING.as_secs())]
    Timeout { to: String },
    #[error("no loopback socket for a tunnel: {0}")]
    Loopback(io::Error),
    #[error("TLS cannot be used: {0}")]
    Setup(#[from] rustls::Error),
}

/// An open tunnel. Dropping it closes it.
pub struct Tunnel {
    local: SocketAddr,
    remote: SocketAddr,
    task: JoinHandle<()>,
    /// Its sender is dropped when the tunnel has ended.
    running: watch::Receiver<()>,
}

impl Tunnel {
    /// Opens a tunnel to the listener at a host. Datagrams come from `endpoint`, an address of this
    /// host. `websocket` wraps each datagram in a message.
    pub async fn open(host: &str, port: u16, websocket: bool, endpoint: SocketAddr) -> Result<Self, TunnelError> {
        let to = if host.contains(':') { format!("[{host}]:{port}") } else { format!("{host}:{port}") };
        let (datagrams, remote) = timeout(OPENING, connect(host, port, websocket, &to))
            .await
            .unwrap_or_else(|_| Err(TunnelError::Timeout { to: to.clone() }))?;
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await.map_err(TunnelError::Loopback)?;
        set_buffers(&socket, LOOPBACK_BUFFER, LOOPBACK_BUFFER);
        socket.connect(endpoint).await.map_err(TunnelError::Loopback)?;
        let local = socket.local_addr().map_err(TunnelError::Loopback)?;
        let (sender, running) = watch::channel(());
        let task = tokio::spawn(async move {
            if let Err(error) = pump::run(datagrams, socket).await {
                tracing::debug!(%to, %error, "a tunnel over TLS has ended");
            }
            drop(sender);
        });
        Ok(Self { local, remote, task, running })
    }

    /// Returns the loopback address that stands for the listener.
    pub fn local_addr(&self) -> SocketAddr {
        self.local
    }

    /// Returns the address of the TCP connection's other end: the listener, or an HTTP proxy.
    pub fn remote_addr(&self) -> SocketAddr {
        self.remote
    }

    /// Waits until the tunnel has ended.
    pub fn ended(&self) -> impl Future<Output = ()> + use<> {
        let mut running = self.running.clone();
        async move { while running.changed().await.is_ok() {} }
    }
}

impl Drop for Tunnel {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn connect(
    host: &str,
    port: u16,
    websocket: bool,
    to: &str,
) -> Result<((Incoming, Outgoing), SocketAddr), TunnelError> {
    // A proxy has another loopback.
    let is_here = host == "localhost" || host.parse().is_ok_and(|ip: IpAddr| ip.is_loopback());
    let proxy = if is_here { None } else { HttpProxy::of(&Matcher::from_env(), to)? };
    let tcp = match proxy {
        None => tcp(host, port).await.map_err(|source| TunnelError::Tcp { to: to.into(), source })?,
        Some(proxy) => {
            let by_proxy = |source| TunnelError::ProxyTcp { proxy: proxy.to_string(), source };
            let refused = |source| TunnelError::Proxy { proxy: proxy.to_string(), source };
            let stream = tcp(&proxy.host, proxy.port).await.map_err(by_proxy)?;
            proxy.connect(stream, to).await.map_err(refused)?
        }
    };
    let failed = |source| TunnelError::Tls { to: to.into(), source };
    let remote = tcp.peer_addr().map_err(failed)?;
    let name = ServerName::try_from(host.to_owned()).map_err(|error| failed(io::Error::other(error)))?;
    let config = Arc::new(credentials::client(websocket)?);
    let tls = TlsConnector::from(config).connect(name, tcp).await.map_err(failed)?;
    if !websocket {
        return Ok((by_length(tls), remote));
    }
    let upgraded = client_async_with_config(format!("wss://{to}/"), tls, Some(websocket_config())).await;
    let (stream, _) = upgraded.map_err(|error| TunnelError::WebSocket { to: to.into(), reason: error.to_string() })?;
    Ok((by_message(stream), remote))
}

async fn tcp(host: &str, port: u16) -> io::Result<TcpStream> {
    let mut failed = io::Error::new(io::ErrorKind::NotFound, "the name has no address");
    for addr in tokio::net::lookup_host((host, port)).await? {
        // An address that does not answer leaves time for the next one.
        match timeout(ONE_ADDRESS, TcpStream::connect(addr)).await {
            Ok(Ok(tcp)) => {
                stream::prepare(&tcp)?;
                return Ok(tcp);
            }
            Ok(Err(error)) => failed = error,
            Err(_) => failed = io::ErrorKind::TimedOut.into(),
        }
    }
    Err(failed)
}
