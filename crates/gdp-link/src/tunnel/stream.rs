//! The options of the TCP connection under a tunnel.

use std::io;

use tokio::net::TcpStream;

use crate::port::limit_unsent;

/// Maximum number of bytes that the kernel holds unsent. More would only delay what follows.
pub const UNSENT: u32 = 16 << 10;

/// Sends without delay, and keeps the kernel's queue short.
pub fn prepare(tcp: &TcpStream) -> io::Result<()> {
    tcp.set_nodelay(true)?;
    limit_unsent(tcp, UNSENT)
}
