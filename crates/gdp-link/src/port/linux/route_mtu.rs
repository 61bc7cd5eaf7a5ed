//! The MTU of the kernel's route to a peer.

use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::os::fd::AsFd;

use gdp_wire::packet::{IPV4_LEN, IPV6_LEN, UDP_LEN};
use parking_lot::Mutex;

use super::sys;
use crate::port::batch::{ETHERNET_PAYLOAD, UDP_MTU};

/// Asks the kernel for routes from one address, in the network namespace of [`RouteMtu::open`].
#[derive(Debug)]
pub struct RouteMtu {
    socket: Mutex<UdpSocket>,
    interface: Option<String>,
}

impl RouteMtu {
    /// `bound` and `interface` are those of the port.
    pub fn open(bound: SocketAddr, interface: Option<&str>) -> io::Result<Self> {
        let mut any_port = bound;
        any_port.set_port(0);
        Ok(Self { socket: Mutex::new(UdpSocket::bind(any_port)?), interface: interface.map(str::to_owned) })
    }

    /// Returns the upper bound for the discovery of the path MTU to a peer: the bytes of a datagram
    /// that fit the route's first interface. Without the bound, QUIC would probe sizes that no
    /// interface of this host can send.
    pub fn upper_bound(&self, to: SocketAddr) -> u16 {
        let mtu = self.ask(to).unwrap_or_else(|error| {
            tracing::debug!(%to, %error, "the MTU of the route to a peer is not known");
            0
        });
        mtu.clamp(ETHERNET_PAYLOAD, UDP_MTU) as u16
    }

    /// Returns the largest datagram in bytes.
    fn ask(&self, to: SocketAddr) -> io::Result<u32> {
        let socket = self.socket.lock();
        // It loses its interface with its peer.
        if let Some(interface) = &self.interface {
            sys::bind_to_interface(socket.as_fd(), interface)?;
        }
        socket.connect(to)?;
        let is_v4 = to.ip().to_canonical().is_ipv4();
        let (level, option, headers) = match is_v4 {
            true => (libc::IPPROTO_IP, libc::IP_MTU, IPV4_LEN),
            false => (libc::IPPROTO_IPV6, libc::IPV6_MTU, IPV6_LEN),
        };
        let mtu = sys::get_option::<libc::c_int>(socket.as_fd(), level, option);
        // The next peer may be reached from another address.
        sys::disconnect(socket.as_fd())?;
        Ok((mtu? as u32).saturating_sub((headers + UDP_LEN) as u32))
    }
}
