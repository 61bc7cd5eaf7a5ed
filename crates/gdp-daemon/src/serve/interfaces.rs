//! Reads interfaces, addresses and resolved neighbour entries from the kernel over netlink, and
//! reports changes. Sets nothing.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::time::{Duration, Instant};

use futures::{Stream, StreamExt, TryStreamExt};
use gdp_core::mac::DisplayMac;
use gdp_util::ticks::next_tick;
use netlink_packet_route::address::AddressAttribute;
use netlink_packet_route::link::{LinkAttribute, LinkFlags, LinkLayerType};
use netlink_packet_route::neighbour::{NeighbourAddress, NeighbourAttribute};
use rtnetlink::{Handle, MulticastGroup};
use serde::Serialize;
use tokio::sync::watch;
use tokio::time::{sleep, timeout_at};

/// The maximum time between two looks at the interfaces, even without a netlink message.
pub const LOOK: Duration = Duration::from_secs(5);

/// The maximum number of stations in the result.
const MAX_STATIONS: usize = 1024;

/// One interface of this network namespace.
#[derive(Clone, Debug, Serialize)]
pub struct InterfaceInfo {
    pub name: String,
    pub index: u32,
    pub up: bool,
    /// Whether GDP can run on it directly.
    #[serde(skip)]
    pub ethernet: bool,
    pub mtu: u32,
    pub addresses: Vec<String>,
    /// The IP and MAC addresses of the resolved stations.
    pub stations: Vec<(String, String)>,
}

/// Returns all interfaces, ordered by index.
pub async fn list() -> Result<Vec<InterfaceInfo>, rtnetlink::Error> {
    let (connection, handle, _) =
        rtnetlink::new_connection().map_err(|error| rtnetlink::Error::NamespaceError(error.to_string()))?;
    let task = tokio::spawn(connection);
    let result = ask(&handle).await;
    task.abort();
    result
}

/// Yields whenever an interface or an address has changed.
pub fn changes() -> std::io::Result<impl Stream<Item = ()> + Unpin> {
    let groups = [MulticastGroup::Link, MulticastGroup::Ipv4Ifaddr, MulticastGroup::Ipv6Ifaddr];
    let (connection, handle, messages) = rtnetlink::new_multicast_connection(&groups)?;
    tokio::spawn(connection);
    // The connection ends with its last handle.
    Ok(messages.map(move |_| drop(handle.clone())))
}

/// What may keep an interface from carrying links.
#[derive(Clone, Debug)]
pub struct InterfaceState {
    pub name: String,
    pub index: u32,
    pub has_carrier: bool,
    pub mtu: u32,
}

/// An interface whose MTU is too small, in bytes, and the MTU that it needs at least.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SmallMtu {
    pub mtu: u32,
    pub needed: u32,
}

/// Returns the state of all interfaces. Interfaces that are down have no carrier.
pub async fn states() -> Result<Vec<InterfaceState>, rtnetlink::Error> {
    let (connection, handle, _) =
        rtnetlink::new_connection().map_err(|error| rtnetlink::Error::NamespaceError(error.to_string()))?;
    let task = tokio::spawn(connection);
    let working = LinkFlags::Up | LinkFlags::LowerUp;
    let states = handle.link().get().execute().map_ok(|message| {
        let (index, has_carrier) = (message.header.index, message.header.flags.contains(working));
        let mut state = InterfaceState { name: String::new(), index, has_carrier, mtu: 0 };
        for attribute in message.attributes {
            match attribute {
                LinkAttribute::IfName(name) => state.name = name,
                LinkAttribute::Mtu(mtu) => state.mtu = mtu,
                _ => {}
            }
        }
        state
    });
    let result = states.try_collect().await;
    task.abort();
    result
}

/// Waits for a change of interfaces, at most [`LOOK`].
pub async fn look(changes: &mut watch::Receiver<()>) {
    if let Ok(Err(_)) = timeout_at(next_tick(LOOK, Instant::now()).into(), changes.changed()).await {
        sleep(LOOK).await;
    }
}

async fn ask(handle: &Handle) -> Result<Vec<InterfaceInfo>, rtnetlink::Error> {
    let mut found = BTreeMap::new();
    let mut links = handle.link().get().execute();
    while let Some(message) = links.try_next().await? {
        let flags = message.header.flags;
        let mut info = InterfaceInfo {
            name: String::new(),
            index: message.header.index,
            up: flags.contains(LinkFlags::Up),
            ethernet: message.header.link_layer_type == LinkLayerType::Ether && !flags.contains(LinkFlags::Loopback),
            mtu: 0,
            addresses: Vec::new(),
            stations: Vec::new(),
        };
        for attribute in message.attributes {
            match attribute {
                LinkAttribute::IfName(name) => info.name = name,
                LinkAttribute::Mtu(mtu) => info.mtu = mtu,
                _ => {}
            }
        }
        found.insert(info.index, info);
    }
    let mut addresses = handle.address().get().execute();
    while let Some(message) = addresses.try_next().await? {
        let Some(info) = found.get_mut(&message.header.index) else { continue };
        let address = message.attributes.iter().find_map(|attribute| match attribute {
            AddressAttribute::Local(address) | AddressAttribute::Address(address) => Some(address),
            _ => None,
        });
        info.addresses.extend(address.map(|address| format!("{address}/{}", message.header.prefix_len)));
    }
    let mut stations = handle.neighbours().get().execute();
    let mut told = 0;
    while let Some(message) = stations.try_next().await? {
        let Some(info) = found.get_mut(&message.header.ifindex) else { continue };
        let (mut ip, mut mac) = (None, None);
        for attribute in &message.attributes {
            match attribute {
                NeighbourAttribute::Destination(NeighbourAddress::Inet(address)) => ip = Some(IpAddr::V4(*address)),
                NeighbourAttribute::Destination(NeighbourAddress::Inet6(address)) => ip = Some(IpAddr::V6(*address)),
                NeighbourAttribute::LinkLayerAddress(bytes) => mac = <[u8; 6]>::try_from(bytes.as_slice()).ok(),
                _ => {}
            }
        }
        if let (Some(ip), Some(mac)) = (ip, mac)
            && !ip.is_multicast()
            && told < MAX_STATIONS
        {
            told += 1;
            info.stations.push((ip.to_string(), DisplayMac(mac).to_string()));
        }
    }
    Ok(found.into_values().collect())
}
