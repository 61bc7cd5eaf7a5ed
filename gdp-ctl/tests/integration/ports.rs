//! Addresses for what starts, ends and starts again at the same one.

use std::net::{SocketAddr, TcpListener, UdpSocket};
use std::sync::atomic::{AtomicU16, Ordering};

/// Below those that the kernel gives to sockets that want any: an address stays free between two
/// that use it.
const FIRST: u16 = 16_000;
const COUNT: u16 = 16_000;

/// An address of this host that nobody uses, and that no other test of this program gets.
pub fn free_addr() -> SocketAddr {
    static NEXT: AtomicU16 = AtomicU16::new(0);
    // Another program like this one most likely begins elsewhere.
    let begin = (std::process::id() % 100) as u16 * (COUNT / 100);
    let addrs = std::iter::repeat_with(|| NEXT.fetch_add(1, Ordering::Relaxed)).take(COUNT.into());
    let mut addrs = addrs.map(|n| SocketAddr::from(([127, 0, 0, 1], FIRST + begin.wrapping_add(n) % COUNT)));
    let is_free = |addr: &SocketAddr| UdpSocket::bind(addr).is_ok() && TcpListener::bind(addr).is_ok();
    addrs.find(is_free).expect("not all are in use")
}
