//! System state that the kernel plane needs for UDP. It covers the addresses at which the daemon's
//! socket receives datagrams, the interfaces with these addresses, and route lookup. This module
//! queries and configures the system; [`crate::Planes`] writes the maps.

use std::ffi::CStr;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::{fs, io};

use gdp_wire::LocalAddress;
use gdp_wire::table::MAX_LOCAL_ADDRESSES;

/// An address of an interface that is up in this network namespace.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InterfaceAddress {
    pub interface: String,
    pub loopback: bool,
    pub ip: IpAddr,
}

/// Returns the addresses at which a socket bound to `bound` receives datagrams. A socket bound to a
/// specific address receives only there. For the unspecified address, returns all addresses except
/// link-local ones; for IPv6 these include IPv4 addresses.
pub fn taken_at(bound: SocketAddr, addresses: Vec<InterfaceAddress>) -> Vec<(LocalAddress, InterfaceAddress)> {
    let own = bound.ip().to_canonical();
    // Every interface has a link-local address, and `bpf_fib_lookup` does not resolve them.
    let link_local = |ip: IpAddr| matches!(ip, IpAddr::V6(ip) if ip.is_unicast_link_local());
    let takes = |ip: IpAddr| match own.is_unspecified() {
        true => (own.is_ipv6() || ip.is_ipv4()) && !link_local(ip),
        false => own == ip,
    };
    let taken = addresses.into_iter().filter(|address| takes(address.ip)).take(MAX_LOCAL_ADDRESSES as usize);
    taken.map(|address| (LocalAddress::new(address.ip, bound.port()), address)).collect()
}

/// Returns the addresses of all interfaces that are up.
pub fn addresses() -> io::Result<Vec<InterfaceAddress>> {
    let mut first = std::ptr::null_mut();
    // SAFETY: the pointer is valid for writing.
    if unsafe { libc::getifaddrs(&mut first) } != 0 {
        return Err(io::Error::last_os_error());
    }
    let (mut found, mut next) = (Vec::new(), first);
    // SAFETY: the call above allocated the list, which is freed below. Each interface name ends
    // with 0.
    while let Some(entry) = unsafe { next.as_ref() } {
        next = entry.ifa_next;
        let up = entry.ifa_flags & libc::IFF_UP as u32 != 0;
        if let (true, Some(ip)) = (up, ip_of(entry.ifa_addr)) {
            // SAFETY: as above.
            let name = unsafe { CStr::from_ptr(entry.ifa_name) };
            let loopback = entry.ifa_flags & libc::IFF_LOOPBACK as u32 != 0;
            found.push(InterfaceAddress { interface: name.to_string_lossy().into_owned(), loopback, ip });
        }
    }
    // SAFETY: this is the list from above, and no reference to it remains.
    unsafe { libc::freeifaddrs(first) };
    Ok(found)
}

fn ip_of(address: *const libc::sockaddr) -> Option<IpAddr> {
    // SAFETY: the pointer is null, or refers to an address with the size of its family.
    unsafe {
        match i32::from(address.as_ref()?.sa_family) {
            libc::AF_INET => {
                let v4 = address.cast::<libc::sockaddr_in>().read_unaligned();
                Some(Ipv4Addr::from(v4.sin_addr.s_addr.to_ne_bytes()).into())
            }
            libc::AF_INET6 => {
                let v6 = address.cast::<libc::sockaddr_in6>().read_unaligned();
                Some(Ipv6Addr::from(v6.sin6_addr.s6_addr).into())
            }
            _ => None,
        }
    }
}

/// Whether the kernel plane can look up routes, or the reason why it cannot.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Routing {
    pub v4: Result<(), String>,
    pub v6: Result<(), String>,
}

impl Routing {
    /// Enables forwarding on `lo` for route lookups. `bpf_fib_lookup` answers only if forwarding is
    /// enabled on the interface in the query. The programs query for `lo`, which never forwards
    /// packets, so this does not make the host a router.
    pub fn enable() -> Self {
        Self {
            v4: forward("ipv4"),
            v6: if gets_routes_by_advertisement() { Err(ADVERTISED.into()) } else { forward("ipv6") },
        }
    }
}

const ADVERTISED: &str = "`net.ipv6.conf.lo.forwarding` is 0, and to set it would remove the default route that a \
                          router advertised; set \
                          it when the system starts";

fn forward(family: &str) -> Result<(), String> {
    let path = format!("/proc/sys/net/{family}/conf/lo/forwarding");
    if fs::read_to_string(&path).is_ok_and(|text| text.trim() == "1") {
        return Ok(());
    }
    fs::write(&path, "1").map_err(|error| format!("{path} cannot be set to 1: {error}"))
}

/// Returns whether enabling forwarding would remove default routes. If IPv6 forwarding is enabled
/// on any interface, the kernel removes default routes learnt from router advertisements.
fn gets_routes_by_advertisement() -> bool {
    const DEFAULT: u32 = 0x0001_0000;
    let enabled = fs::read_to_string("/proc/sys/net/ipv6/conf/lo/forwarding").is_ok_and(|text| text.trim() == "1");
    let routes = fs::read_to_string("/proc/self/net/ipv6_route").unwrap_or_default();
    let flags = routes.lines().filter_map(|line| u32::from_str_radix(line.split_whitespace().nth(8)?, 16).ok());
    !enabled && flags.into_iter().any(|flags| flags & DEFAULT != 0)
}

#[cfg(test)]
#[path = "../tests/unit/udp.rs"]
mod tests;
