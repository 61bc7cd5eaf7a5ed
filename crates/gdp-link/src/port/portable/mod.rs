//! The sockets of a port on systems other than Linux: UDP with one socket.
//!
//! Raw Ethernet, and links over one interface, need Linux.

mod data;
pub mod ethernet;
mod udp;
#[cfg(test)]
#[path = "../../../tests/unit/port/portable/udp.rs"]
mod udp_tests;
mod wake;

pub use data::DataSocket;
pub use udp::SharedUdp;
pub use wake::WakeEvent;

use std::io;

use socket2::SockRef;
use tokio::net::TcpStream;

/// Requests socket buffers of the given sizes, in bytes.
pub fn set_buffers<'s, S>(socket: &'s S, receive: usize, send: usize)
where
    SockRef<'s>: From<&'s S>,
{
    let socket = SockRef::from(socket);
    // A smaller buffer is no error: its effect is visible in the counters.
    let _ = socket.set_recv_buffer_size(receive);
    let _ = socket.set_send_buffer_size(send);
}

/// Does nothing: the system decides how much it holds unsent for a TCP connection.
pub fn limit_unsent(_: &TcpStream, _: u32) -> io::Result<()> {
    Ok(())
}
