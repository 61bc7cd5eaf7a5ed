//! Whether two sockets are on the same host, in the same network namespace.

use std::fs;
use std::os::fd::BorrowedFd;

use gdp_core::crypto;

use super::sys;

/// Returns a number for the network namespace of a socket, unique to this boot of this host.
/// Returns `None` if the kernel (before 5.14) does not report it. Compare it for equality only:
/// containers, and virtual machines behind the host's own address, have another number.
pub fn id(socket: BorrowedFd) -> Option<u64> {
    const SO_NETNS_COOKIE: libc::c_int = 71;
    let cookie: u64 = sys::get_option(socket, libc::SOL_SOCKET, SO_NETNS_COOKIE).ok()?;
    let boot = fs::read("/proc/sys/kernel/random/boot_id").ok()?;
    let digest = crypto::sha256(&[b"gdp/host/1", &boot, &cookie.to_be_bytes()]);
    digest.first_chunk().map(|first| u64::from_be_bytes(*first))
}

/// Returns whether a socket bound to the unspecified IPv6 address also accepts datagrams over IPv4.
pub fn takes_ipv4(socket: BorrowedFd) -> bool {
    matches!(sys::get_option::<libc::c_int>(socket, libc::IPPROTO_IPV6, libc::IPV6_V6ONLY), Ok(0))
}

#[cfg(test)]
#[path = "../../../tests/unit/port/linux/host_id.rs"]
mod tests;
