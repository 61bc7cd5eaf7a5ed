//! Takes over the BPF maps of an earlier daemon. It reads the addresses of links, the readers of
//! groups, and the routes back from them.

use std::collections::{HashMap, HashSet};
use std::net::{IpAddr, SocketAddr};

use gdp_link::link::KeyedEntry;
use gdp_link::port::LinkAddr;
use gdp_wire::table::{ANY_WRITER, EGRESS_SET_SIZE, NEIGHBOURS, PORT_ROUTED, ip_of, mac_bytes};
use gdp_wire::{Carrier, FibEntry, LinkEntry, LinkRole, Name, Permit};

use crate::data_plane::DataPlane as _;
use crate::dispatcher::Dispatcher;
use crate::kernel::Adopted;
use crate::kernel_failures::UpdateError;
use crate::route::PlaneRoute;
use crate::tables::UserTables;

/// State of an earlier daemon in the kernel that the control plane has neither confirmed nor
/// removed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Left {
    /// This switch's egress bit.
    pub own_bit: u64,
    /// Links, each with the address of its frames.
    pub links: Vec<(KeyedEntry, LinkAddr)>,
    pub routes: Vec<(Name, PlaneRoute)>,
    pub next_hops: [u32; EGRESS_SET_SIZE as usize],
}

/// Copies the state of the fast path to the userspace plane.
pub fn adopt(state: &mut Dispatcher, adopted: Adopted) -> Result<Left, UpdateError> {
    let Adopted { config, links, routes, next_hops, ports, groups, sources } = adopted;
    state.own_bit = config.own_bit;
    let ports: HashSet<u32> = ports.into_iter().map(|(port, _)| port).collect();
    let mut left = Left { own_bit: config.own_bit, links: Vec::new(), routes: Vec::new(), next_hops };
    for entry in links {
        let to = address_of(&entry);
        let is_udp = matches!(to, Some(LinkAddr::Udp(_)));
        if let Some(to) = to.filter(|_| is_udp || ports.contains(&entry.port)) {
            state.userspace.set_link(&entry, to)?;
            state.fast_path.iter_mut().for_each(|fast_path| _ = fast_path.follow_route(&entry));
            left.links.push((entry, to));
        } else {
            // The address of this link is not in the maps; only the earlier daemon had it.
            state.on_fast_path(|fast_path| fast_path.remove_link(entry.id))?;
        }
    }
    state.userspace.set_own_bit(config.own_bit)?;
    state.userspace.set_next_hops(&next_hops)?;
    let readers = readers(&state.userspace.tables, &groups);
    let mut sources = sources_of(&state.userspace.tables, sources);
    // Entries with their own group number come first, so that no other entry takes that number.
    let (numbered, others): (Vec<_>, Vec<_>) =
        routes.into_iter().partition(|(_, entry)| readers.contains_key(&entry.group));
    for (name, entry) in numbered.into_iter().chain(others) {
        let readers = readers.get(&entry.group).map(Vec::as_slice);
        let route = route_of(&entry, readers, sources.remove(&name).unwrap_or_default());
        // Reuse the number, so that frames in flight see no change.
        state.set_route(name, &route, readers.map(|_| entry.group))?;
        left.routes.push((name, route));
    }
    // Remove permits only after the entries that refer to them, because forwarding continues
    // meanwhile.
    let stay = left.routes.iter().flat_map(|(name, route)| route.source_permits(name)).collect();
    state.on_fast_path(|fast_path| fast_path.retain_permits(&stay))?;
    for group in readers.into_keys().filter(|group| state.groups.readers(*group).is_empty()) {
        state.fast_path.iter_mut().for_each(|fast_path| fast_path.release_group(group));
    }
    Ok(left)
}

/// Returns the address of a link, if its entry contains it.
fn address_of(entry: &LinkEntry) -> Option<LinkAddr> {
    let carrier = &entry.carrier;
    match carrier.kind {
        Carrier::ETHERNET if entry.port < PORT_ROUTED => {
            Some(LinkAddr::Ethernet { ifindex: entry.port, mac: mac_bytes(carrier.peer_mac) })
        }
        Carrier::UDP4 | Carrier::UDP6 => {
            let ip = ip_of(carrier.kind, carrier.peer_ip);
            // A link-local address is not usable without its interface.
            let link_local = matches!(ip, IpAddr::V6(ip) if ip.is_unicast_link_local());
            (!link_local).then(|| LinkAddr::udp(SocketAddr::new(ip, u16::from_be(carrier.peer_port))))
        }
        _ => None,
    }
}

/// Returns the links on which frames from each name may arrive, sorted. Links that no longer exist
/// are omitted.
fn sources_of(tables: &UserTables, permits: Vec<Permit>) -> HashMap<Name, Vec<u32>> {
    let mut sources: HashMap<Name, Vec<u32>> = HashMap::new();
    for permit in permits.into_iter().filter(|permit| tables.link(permit.link).is_some()) {
        sources.entry(permit.name).or_default().push(permit.link);
    }
    sources.values_mut().for_each(|links| links.sort_unstable());
    sources
}

/// Returns the local readers of each group that has any, sorted.
fn readers(tables: &UserTables, groups: &[(u32, Vec<u32>)]) -> HashMap<u32, Vec<u32>> {
    let is_reader = |id: &u32| tables.link(*id).is_some_and(|link| link.role != LinkRole::Switch as u32);
    let of = |members: &[u32]| {
        let mut readers: Vec<u32> = members.iter().copied().filter(is_reader).collect();
        readers.sort_unstable();
        readers
    };
    let groups = groups.iter().map(|(group, members)| (*group, of(members)));
    groups.filter(|(group, readers)| *group != NEIGHBOURS && !readers.is_empty()).collect()
}

/// Returns the route of a name. The permits of several writers cannot be read back. Until the RIB
/// states them again, every endpoint may send to the name under its own name. Other domains may
/// send as the names permitted to them. Readers verify writers themselves. `readers`: readers of
/// the group, as far as the kernel had them.
fn route_of(entry: &FibEntry, readers: Option<&[u32]>, sources: Vec<u32>) -> PlaneRoute {
    let only = Some(entry.local_link).filter(|link| *link != 0);
    PlaneRoute {
        egress_bits: entry.egress_bits,
        readers: readers.map_or_else(|| only.into_iter().collect(), <[u32]>::to_vec),
        writers: match (entry.writer_link, entry.more_writers) {
            (0, _) => Vec::new(),
            (writer, 0) => vec![writer],
            _ => vec![ANY_WRITER],
        },
        sources,
    }
}
