//! The options of the TCP connection under a tunnel.

use std::io;
use std::os::fd::AsFd;

use tokio::net::TcpStream;

use crate::port::sys;

/// Maximum number of bytes that the kernel holds unsent. More would only delay what follows.
pub const UNSENT: u32 = 16 << 10;

/// Sends without delay, and keeps the kernel's queue short.
pub fn prepare(tcp: &TcpStream) -> io::Result<()> {
    tcp.set_nodelay(true)?;
    sys::set_option(tcp.as_fd(), libc::IPPROTO_TCP, libc::TCP_NOTSENT_LOWAT, &UNSENT)
}
