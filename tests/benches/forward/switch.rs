//! A switch of a chain without a daemon: its planes, attached to both interfaces.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use gdp_core::identity::Identity;
use gdp_dataplane::dpdk::{DpdkConfig, DpdkPort};
use gdp_dataplane::{PlaneConfig, PlaneRoute, Planes, Wanted};
use gdp_link::link::LinkIds;
use gdp_link::port::{LinkAddr, Port, PortConfig};
use gdp_tests::measure::cpu;
use gdp_tests::netns::{Entered, Namespace};
use gdp_wire::table::ip_words;
use gdp_wire::{Carrier, Counter, LinkEntry, LinkRole, Name, UDP_PORT};

/// The destination of all frames.
pub const TOPIC: Name = Name::from_bytes([0xd0; 32]);

/// Index and id of each switch's link to the left and to the right.
pub const LEFT: u32 = 1;
pub const RIGHT: u32 = 2;

/// The medium that carries frames on a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Medium {
    Ethernet,
    Udp4,
    Udp6,
}

pub struct Switch {
    planes: Planes,
    ports: Vec<Port>,
    runtime: tokio::runtime::Runtime,
}

/// The position of a switch in a chain, and the media of its links.
#[derive(Clone, Copy, Debug)]
pub struct Position {
    /// Index from the left, from 0.
    pub index: usize,
    pub hops: usize,
    /// Media to the left and to the right.
    pub media: [Medium; 2],
}

impl Switch {
    /// Starts a switch that forwards frames for [`TOPIC`] from left to right. `driver`: the DPDK
    /// driver, if DPDK owns the interfaces.
    pub fn start(
        at: &Namespace,
        wanted: Wanted,
        (ebpf_object, driver): (&Path, Option<&str>),
        position: Position,
    ) -> Result<Self> {
        let Position { index: i, hops, media } = position;
        let inside = at.enter()?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let within = runtime.enter();
        let ebpf_object = Some(ebpf_object.into());
        // The loop runs on testpmd's core, and leaves the CPU to others between measurements.
        let (cores, idle) = (vec![cpu::OTHER], Duration::from_millis(10));
        let dpdk = DpdkConfig { ports: driver.map_or_else(Vec::new, ports), cores, idle, ..DpdkConfig::default() };
        let config = PlaneConfig { wanted, ebpf_object, dpdk, count_losses: false, ..Default::default() };
        let planes = Planes::open(config)?;
        drop(within);
        let mut switch = Self { planes, ports: Vec::new(), runtime };
        let (first, last) = (i == 0, i + 1 == hops);
        let own_bit = 1 << i;
        let beyond = ((1 << hops) - 1) & !(own_bit | (own_bit - 1));
        let left = LinkEntry { id: LEFT, reach: own_bit - 1, ..link(first, i, (1, 2), media[0]) };
        let right = LinkEntry { id: RIGHT, reach: beyond, ..link(last, i + 1, (2, 1), media[1]) };
        switch.planes.set_own_bit(own_bit)?;
        let mut addresses = Vec::new();
        let interfaces = if driver.is_some() { ["gl0", "gr0"] } else { ["l0", "r0"] };
        for ((interface, medium), (link, peer, own)) in interfaces.iter().zip(media).zip([(i, 1, 2), (i + 1, 2, 1)]) {
            addresses.push(match medium {
                Medium::Ethernet => {
                    LinkAddr::Ethernet { ifindex: switch.attach(&inside, interface)?, mac: mac(link, peer) }
                }
                Medium::Udp4 | Medium::Udp6 => {
                    give_address(at, interface, link_ip(medium, link, own))?;
                    know_neighbour(at, interface, link_ip(medium, link, peer), mac(link, peer))?;
                    LinkAddr::Udp(link_socket(medium, link, peer))
                }
            });
        }
        if media.iter().any(|medium| *medium != Medium::Ethernet) {
            switch.attach_udp(&inside)?;
        }
        let planes = &mut switch.planes;
        planes.set_link(left, addresses[0])?;
        planes.set_link(right, addresses[1])?;
        if first || last {
            let readers = if last { vec![RIGHT] } else { vec![] };
            planes.set_route(
                TOPIC,
                &PlaneRoute { egress_bits: 1 << (hops - 1), readers, writers: vec![LEFT], ..PlaneRoute::default() },
            )?;
        }
        let mut next_hops = [0; 64];
        (i + 1..hops).for_each(|bit| next_hops[bit] = RIGHT);
        planes.set_next_hops(&next_hops)?;
        Ok(switch)
    }

    /// Routes another name to the left and to the right.
    pub fn copy_another_name(&mut self, _inside: &Entered) -> Result<()> {
        let route = PlaneRoute { egress_bits: u64::MAX, readers: vec![LEFT, RIGHT], ..PlaneRoute::default() };
        Ok(self.planes.set_route(Name::from_bytes([0xd1; 32]), &route)?)
    }

    /// Attaches to an interface of the calling thread's network namespace and returns its index.
    pub fn attach(&mut self, _inside: &Entered, interface: &str) -> Result<u32> {
        let _within = self.runtime.enter();
        let port = Port::ethernet(interface, &PortConfig::switch(Identity::generate("switch")?, LinkIds::new()))?;
        let found = port.interface().context("an Ethernet port has an interface")?.clone();
        self.planes.attach(&found, port.data())?;
        self.ports.push(port);
        Ok(found.index)
    }

    /// Attaches to UDP at any address.
    fn attach_udp(&mut self, _inside: &Entered) -> Result<()> {
        let _within = self.runtime.enter();
        let any = SocketAddr::new(Ipv6Addr::UNSPECIFIED.into(), UDP_PORT);
        let port = Port::udp(any, &PortConfig::switch(Identity::generate("switch")?, LinkIds::new()))?;
        self.planes.attach_udp(port.data(), port.udp_addr().context("a UDP port has an address")?, None)?;
        self.ports.push(port);
        Ok(())
    }

    /// Fails unless frames were counted under `expected` by one plane alone. The only permitted
    /// drop reason is `may`.
    pub fn check(&self, expected: Counter, in_kernel: bool, may: Option<Counter>) -> Result<()> {
        for (counter, kernel, userspace) in self.planes.counters()? {
            let (ours, other) = if in_kernel { (kernel, userspace) } else { (userspace, kernel) };
            let fine = if counter == expected {
                ours > 0 && other == 0
            } else {
                !counter.is_drop() || ours == 0 || may == Some(counter)
            };
            ensure!(fine, "{} is {kernel} in the kernel, {userspace} in userspace", counter.as_str());
        }
        Ok(())
    }
}

/// Returns the interfaces as DPDK ports. All switches share one process, where device names must be
/// unique.
fn ports(driver: &str) -> Vec<DpdkPort> {
    static NUMBER: AtomicU32 = AtomicU32::new(0);
    let port = |interface: &str| DpdkPort {
        interface: format!("g{interface}"),
        device: format!("{driver}{},iface={interface}", NUMBER.fetch_add(1, Ordering::Relaxed)),
        mtu: None,
    };
    ["l0", "r0"].map(port).into()
}

/// Returns a link with one key for both directions. The neighbour calls it LEFT, because frames go
/// to the right. `link`: its index in the chain. `(peer, own)`: the ends, 1 or 2.
pub fn link(endpoint: bool, link: usize, (peer, own): (u8, u8), medium: Medium) -> LinkEntry {
    let (kind, peer_ip) = ip_words(link_ip(medium, link, peer));
    let carrier = match medium {
        Medium::Ethernet => Carrier::ethernet(mac(link, peer), mac(link, own)),
        Medium::Udp4 | Medium::Udp6 => Carrier {
            kind,
            flags: Carrier::ZERO_CHECKSUM,
            peer_port: UDP_PORT.to_be(),
            local_port: UDP_PORT.to_be(),
            peer_ip,
            local_ip: ip_words(link_ip(medium, link, own)).1,
            ..Carrier::default()
        },
    };
    LinkEntry {
        peer_id: LEFT,
        role: if endpoint { LinkRole::Endpoint } else { LinkRole::Switch } as u32,
        rx_keys: [key(link); 2],
        tx_keys: [key(link); 2],
        mtu: if medium == Medium::Ethernet { 1500 } else { 1400 },
        carrier,
        ..LinkEntry::default()
    }
}

pub fn key(link: usize) -> [u64; 2] {
    [link as u64, 0x6764_7062_656e_6368]
}

/// Returns the MAC address of an end in a chain: link 0 is robot – s1, end 1 is its left end.
pub fn mac(link: usize, end: u8) -> [u8; 6] {
    [2, 0, 0, 0, link as u8, end]
}

/// Returns the source address of datagrams from an end of a link.
pub fn link_socket(medium: Medium, link: usize, end: u8) -> SocketAddr {
    SocketAddr::new(link_ip(medium, link, end), UDP_PORT)
}

/// Returns the address of an end of a link. IPv4 addresses equal those of a chain of routers, even
/// without routers.
pub fn link_ip(medium: Medium, link: usize, end: u8) -> IpAddr {
    match medium {
        Medium::Udp6 => Ipv6Addr::new(0xfd09, 0, 0, link as u16, 0, 0, 0, end.into()).into(),
        Medium::Ethernet | Medium::Udp4 => Ipv4Addr::new(10, 9, link as u8, end).into(),
    }
}

fn give_address(at: &Namespace, interface: &str, ip: IpAddr) -> Result<()> {
    if ip.is_ipv4() {
        return at.ip(&["addr", "add", &format!("{ip}/24"), "dev", interface]).map(drop);
    }
    at.enable_ipv6()?;
    at.ip(&["addr", "add", &format!("{ip}/64"), "dev", interface, "nodad"]).map(drop)
}

/// Adds a static neighbour entry: the neighbour need not answer.
pub fn know_neighbour(at: &Namespace, interface: &str, ip: IpAddr, mac: [u8; 6]) -> Result<()> {
    let mac = mac.map(|byte| format!("{byte:02x}")).join(":");
    at.ip(&["neigh", "replace", &ip.to_string(), "lladdr", &mac, "dev", interface, "nud", "permanent"]).map(drop)
}
