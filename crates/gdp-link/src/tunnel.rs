//! The carrier over TLS on TCP, for networks that let no UDP out.
//!
//! A tunnel carries the datagrams of one link, as TURN does over TLS (RFC 8656, section 2.1). Each
//! side has a loopback socket, so links, data planes and rights are those of UDP:
//!
//! ```text
//!   endpoint ── loopback ── Tunnel ══ TLS on TCP ══ TlsListener ── loopback ── UDP port of the switch
//! ```
//!
//! Nobody trusts the listener's certificate. The QUIC connection inside authenticates both
//! entities.

mod admission;
mod client;
mod credentials;
mod framing;
mod http_proxy;
mod peers;
mod pump;
mod queue;
mod server;
mod stream;

/// Size of a loopback socket's buffers in bytes. A large message arrives on it in one burst.
const LOOPBACK_BUFFER: usize = 4 << 20;

pub use client::{Tunnel, TunnelError};
pub use peers::TunnelPeers;
pub use server::TlsListener;
