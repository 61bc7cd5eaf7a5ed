//! Addresses for programs that start, end and start again at the same address.

use std::net::{SocketAddr, TcpListener, UdpSocket};
use std::sync::atomic::{AtomicU16, Ordering};

/// First port. The range is below the kernel's ephemeral ports, so an address stays free between
/// two uses.
const FIRST: u16 = 16_000;
const COUNT: u16 = 16_000;

/// Returns a free address of this host that no other test of this program gets.
pub fn free_addr() -> SocketAddr {
    static NEXT: AtomicU16 = AtomicU16::new(0);
    // Another process of this kind most likely starts elsewhere in the range.
    let begin = (std::process::id() % 100) as u16 * (COUNT / 100);
    let addrs = std::iter::repeat_with(|| NEXT.fetch_add(1, Ordering::Relaxed)).take(COUNT.into());
    let mut addrs = addrs.map(|n| SocketAddr::from(([127, 0, 0, 1], FIRST + begin.wrapping_add(n) % COUNT)));
    let is_free = |addr: &SocketAddr| UdpSocket::bind(addr).is_ok() && TcpListener::bind(addr).is_ok();
    addrs.find(is_free).expect("not all are in use")
}
