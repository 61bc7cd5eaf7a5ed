//! The pair of interfaces that connects endpoints on the switch's own host with its XDP program:
//!
//! ```text
//!   endpoint's socket ── IP ── gdp75e1a2b3h ═══ gdp75e1a2b3s ── XDP ──▶ other interfaces
//!                              169.254.31.64    169.254.31.65
//!                              of the host      unassigned: the host routes it to the pair
//! ```
//!
//! This module creates, finds and removes the pair over netlink, which needs CAP_NET_ADMIN. It does
//! not handle the traffic on the pair. Like the program, the pair outlives a daemon that is killed.
//! The daemon (`serve`) and `gdp-ctl xdp detach` call this module.

use std::io;
use std::net::Ipv4Addr;
use std::path::Path;

use gdp_link::port::{HostPair, Interface};
use gdp_wire::Name;
use gdp_wire::packet::{IPV4_LEN, UDP_LEN};
use netlink_packet_route::address::{AddressAttribute, AddressScope};
use rtnetlink::{Handle, LinkUnspec, LinkVeth};

use super::{device, udp};

/// MTU in bytes, without the Ethernet header. Each kernel attaches the program at this size.
const MTU: u32 = 1500;

/// Address range of all pairs. Each pair uses two addresses; the host has the even one.
const ADDRESSES: [u8; 3] = [169, 254, 31];

/// Both ends of a pair.
#[derive(Clone, Debug)]
pub struct Ends {
    /// The end with the program.
    pub switch: Interface,
    pub addresses: HostPair,
}

/// Reasons why there is no pair.
#[derive(Debug, thiserror::Error)]
pub enum HostPairError {
    #[error("{interface}: {source}")]
    Io { interface: String, source: io::Error },
    #[error("{interface}: {source}")]
    Netlink { interface: String, source: rtnetlink::Error },
    #[error("all addresses in 169.254.31.0/24 are in use on this host")]
    NoAddress,
}

/// Returns whether an interface is an end of the pair of any switch.
pub fn is_end(interface: &str) -> bool {
    let digits = interface.strip_prefix("gdp").and_then(|rest| rest.strip_suffix(['h', 's']));
    digits.is_some_and(|digits| digits.len() == 8 && digits.bytes().all(|c| c.is_ascii_hexdigit()))
}

/// Returns the pair of a switch in the calling thread's network namespace. Creates it unless an
/// earlier daemon left one.
pub async fn open(switch: &Name) -> Result<Ends, HostPairError> {
    let [host, inner] = names(&switch.to_string());
    let io_at = |interface: &str| {
        let interface = interface.to_owned();
        move |source| HostPairError::Io { interface, source }
    };
    let netlink = Netlink::open().map_err(io_at(&host))?;
    let at = |source| HostPairError::Netlink { interface: host.clone(), source };
    let handle = &netlink.handle;
    if Interface::find(&host).is_err() || Interface::find(&inner).is_err() {
        handle.link().add(LinkVeth::new(&host, &inner).mtu(MTU).build()).execute().await.map_err(at)?;
    }
    let (outer, switch_end) =
        (Interface::find(&host).map_err(io_at(&host))?, Interface::find(&inner).map_err(io_at(&inner))?);
    for end in [&outer, &switch_end] {
        // Only GDP frames may use the pair, so disable neighbour discovery, and multicast for DDS
        // discovery.
        let _ = std::fs::write(Path::new("/proc/sys/net/ipv6/conf").join(&end.name).join("disable_ipv6"), "1");
        let up = LinkUnspec::new_with_index(end.index).multicast(false).up().build();
        handle.link().set(up).execute().await.map_err(at)?;
    }
    let host_ip = addresses(&host, switch).map_err(io_at(&host))?.ok_or(HostPairError::NoAddress)?;
    let pair = HostPair {
        switch_ip: Ipv4Addr::from_bits(host_ip.to_bits() | 1),
        switch_mac: switch_end.mac,
        host_ip,
        host_mac: outer.mac,
        mtu: MTU - (IPV4_LEN + UDP_LEN) as u32,
    };
    let mut address = handle.address().add(outer.index, host_ip.into(), 32).replace();
    let message = address.message_mut();
    message.header.scope = AddressScope::Link;
    message.attributes = vec![
        AddressAttribute::Local(host_ip.into()),
        // The peer address adds a route to the other end, and avoids a broadcast address.
        AddressAttribute::Address(pair.switch_ip.into()),
    ];
    address.execute().await.map_err(at)?;
    let neighbour = handle.neighbours().add(outer.index, pair.switch_ip.into()).replace();
    neighbour.link_layer_address(&pair.switch_mac).execute().await.map_err(at)?;
    // The host's end accepts redirected frames only with GRO.
    device::set_gro(&host).map_err(io_at(&host))?;
    Ok(Ends { switch: switch_end, addresses: pair })
}

/// Removes the pair of the switch whose name begins with these digits, in the calling thread's
/// network namespace. Returns whether there was one.
pub async fn remove(switch: &str) -> Result<bool, HostPairError> {
    let [host, _] = names(switch);
    let Ok(interface) = Interface::find(&host) else { return Ok(false) };
    let netlink = Netlink::open().map_err(|source| HostPairError::Io { interface: host.clone(), source })?;
    let removed = netlink.handle.link().del(interface.index).execute().await;
    removed.map(|()| true).map_err(|source| HostPairError::Netlink { interface: host, source })
}

/// Returns the interface names of the host's and the switch's end.
fn names(switch: &str) -> [String; 2] {
    ['h', 's'].map(|end| format!("gdp{}{end}", switch.get(..8).unwrap_or(switch)))
}

/// Returns the current address of the host's end, or a free address for it, if any. The search
/// starts at an address derived from the switch's name, so that switches of one host seldom
/// collide.
fn addresses(host: &str, switch: &Name) -> io::Result<Option<Ipv4Addr>> {
    let taken = udp::addresses()?;
    let taken = taken.iter().filter_map(|address| match address.ip {
        std::net::IpAddr::V4(ip) => Some((ip, address.interface == host)),
        std::net::IpAddr::V6(_) => None,
    });
    let taken: Vec<(Ipv4Addr, bool)> = taken.filter(|(ip, _)| ip.octets()[..3] == ADDRESSES).collect();
    if let Some((own, _)) = taken.iter().find(|(_, own)| *own) {
        return Ok(Some(*own));
    }
    let first = switch.as_bytes()[0] & !1;
    let [a, b, c] = ADDRESSES;
    let candidates = (0..128).map(|i| Ipv4Addr::new(a, b, c, first.wrapping_add(2 * i)));
    let free = |ip: &Ipv4Addr| taken.iter().all(|(other, _)| other.to_bits() & !1 != ip.to_bits());
    Ok(candidates.into_iter().find(free))
}

/// A netlink connection. Dropping it ends its task.
struct Netlink {
    handle: Handle,
    task: tokio::task::JoinHandle<()>,
}

impl Netlink {
    fn open() -> io::Result<Self> {
        let (connection, handle, _) = rtnetlink::new_connection()?;
        Ok(Self { handle, task: tokio::spawn(connection) })
    }
}

impl Drop for Netlink {
    fn drop(&mut self) {
        self.task.abort();
    }
}

#[cfg(test)]
#[path = "../tests/unit/host_pair.rs"]
mod tests;
