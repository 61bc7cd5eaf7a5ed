//! Endpoints beside their switch: on the same host and in the same network namespace. The daemon of
//! a switch gives such endpoints a pair of interfaces, one end of which has the switch's XDP
//! program; their data frames go there, and not through the daemon. What an endpoint needs for that
//! is said in the hellos of its link (`crate::link::hello`); QUIC stays where it was dialled.

use std::fs;
use std::net::Ipv4Addr;
use std::os::fd::BorrowedFd;
use std::sync::Arc;

use super::sys;
use gdp_core::crypto::Backend;
use parking_lot::Mutex;

/// The addresses of a switch and of its host on the pair of interfaces between them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostPair {
    /// Where endpoints send frames to. Link-local, and no address of the host: routed to the host's
    /// end of the pair.
    pub switch_ip: Ipv4Addr,
    /// Of the end that has the program.
    pub switch_mac: [u8; 6],
    /// Where frames for endpoints are sent to, at the port of each.
    pub host_ip: Ipv4Addr,
    pub host_mac: [u8; 6],
}

/// The pair that a port has now, if any. Clones are the same.
#[derive(Clone, Default)]
pub(crate) struct CurrentPair(Arc<Mutex<Option<HostPair>>>);

impl CurrentPair {
    pub fn get(&self) -> Option<HostPair> {
        *self.0.lock()
    }

    pub fn set(&self, pair: Option<HostPair>) {
        *self.0.lock() = pair;
    }
}

/// A number for the network namespace of a socket, unique to this boot of this host. `None` if the
/// kernel (before 5.14) does not say. Only its equality means anything: containers, and
/// virtual machines behind the host's own address, have another.
pub fn id(socket: BorrowedFd) -> Option<u64> {
    const SO_NETNS_COOKIE: libc::c_int = 71;
    let cookie: u64 = sys::get_option(socket, libc::SOL_SOCKET, SO_NETNS_COOKIE).ok()?;
    let boot = fs::read("/proc/sys/kernel/random/boot_id").ok()?;
    let digest = Backend::default().sha256(&[b"gdp/host/1", &boot, &cookie.to_be_bytes()]);
    digest.first_chunk().map(|first| u64::from_be_bytes(*first))
}

/// Whether a socket bound to the unspecified IPv6 address takes datagrams over IPv4 as well.
pub fn takes_ipv4(socket: BorrowedFd) -> bool {
    matches!(sys::get_option::<libc::c_int>(socket, libc::IPPROTO_IPV6, libc::IPV6_V6ONLY), Ok(0))
}

#[cfg(test)]
#[path = "../../tests/unit/port/host.rs"]
mod tests;
