//! A chain of switches of one kind, ready to carry frames from the robot's end to the cloud's.

use std::path::Path as FilePath;

use anyhow::{Context, Result, ensure};
use gdp::identity::Identity;
use gdp::link::LinkIds;
use gdp::port::{LinkAddr, Port, PortConfig};
use gdp_ctl::plane::{PlaneConfig, PlaneRoute, Planes, Wanted};
use gdp_tests::chain::{Chain, ChainOptions};
use gdp_tests::frames::Frame;
use gdp_tests::netns::{Namespace, execute};
use gdp_wire::{Carrier, Counter, LinkEntry, LinkRole, Name};
use serde::Serialize;

/// What forwards.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    Xdp,
    Ip,
    Userspace,
}

pub struct Path {
    kind: Kind,
    chain: Chain,
    switches: Vec<Switch>,
}

struct Switch {
    planes: Planes,
    _ports: Vec<Port>,
    _runtime: tokio::runtime::Runtime,
}

const TOPIC: Name = Name::from_bytes([0xd0; 32]);

/// The index, and so the id, of each switch's link to the left and to the right.
const LEFT: u32 = 1;
const RIGHT: u32 = 2;

impl Path {
    pub fn build(kind: Kind, hops: usize, ebpf_object: &FilePath) -> Result<Self> {
        let chain = Chain::build(ChainOptions { switches: hops, ..Default::default() })?;
        for node in chain.nodes() {
            refresh_gro(node)?;
        }
        let mut switches = Vec::new();
        match kind {
            Kind::Ip => {
                chain.become_ip_routers()?;
                let (_, cloud) = chain.ip_ends();
                // The sink drops what the cloud would answer ARP with only if it is long: this resolves the last hop.
                let last = &chain.switches()[hops - 1];
                last.ip(&["neigh", "replace", &cloud, "lladdr", &mac_text(hops, 2), "dev", "r0", "nud", "permanent"])?;
            }
            Kind::Xdp | Kind::Userspace => {
                let wanted = if kind == Kind::Xdp { Wanted::Xdp } else { Wanted::Userspace };
                for (i, namespace) in chain.switches().iter().enumerate() {
                    switches.push(Switch::start(namespace, wanted, ebpf_object, i, hops)?);
                }
            }
        }
        Ok(Self { kind, chain, switches })
    }

    pub fn kind(&self) -> Kind {
        self.kind
    }

    pub fn hops(&self) -> usize {
        self.chain.switches().len()
    }

    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    /// The frame to send from the robot.
    pub fn frame(&self, payload: usize) -> Vec<u8> {
        let ethertype = if self.kind == Kind::Ip { 0x0800 } else { gdp_wire::ETHERTYPE };
        let frame = Frame {
            ethertype,
            to_mac: mac(0, 2),
            from_mac: mac(0, 1),
            link_id: LEFT,
            key: key(0),
            destination: TOPIC.to_bytes(),
            payload: vec![0x5a; payload],
            ..Frame::default()
        };
        match self.kind {
            Kind::Xdp | Kind::Userspace => frame.bytes(),
            Kind::Ip => ipv4(frame.ethernet(), frame.bytes().len(), self.hops() as u8),
        }
    }

    /// The link that the robot's frames leave by, as the robot holds it; none for IP.
    pub fn robot_link(&self) -> LinkEntry {
        match self.kind {
            Kind::Ip => LinkEntry::default(),
            Kind::Xdp | Kind::Userspace => {
                LinkEntry { id: LEFT, peer_id: LEFT, tx_keys: [key(0); 2], ..LinkEntry::default() }
            }
        }
    }

    /// The frames took the way that was to be measured, and no other.
    pub fn check(&self) -> Result<()> {
        for (i, switch) in self.switches.iter().enumerate() {
            let last = i + 1 == self.switches.len();
            let expected = if last { Counter::Delivered } else { Counter::Forwarded };
            for (counter, kernel, userspace) in switch.planes.counters()? {
                let (ours, other) = if self.kind == Kind::Xdp { (kernel, userspace) } else { (userspace, kernel) };
                let fine = if counter == expected { ours > 0 && other == 0 } else { !counter.is_drop() || ours == 0 };
                ensure!(fine, "s{}: {} is {kernel} in the kernel, {userspace} in userspace", i + 1, counter.as_str());
            }
        }
        Ok(())
    }
}

impl Switch {
    fn start(at: &Namespace, wanted: Wanted, ebpf_object: &FilePath, i: usize, hops: usize) -> Result<Self> {
        let _inside = at.enter()?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let _runtime = runtime.enter();
        let config = PlaneConfig { wanted, ebpf_object: Some(ebpf_object.into()), ..Default::default() };
        let mut planes = Planes::open(config)?;
        let mut ports = Vec::new();
        let mut addresses = Vec::new();
        for (interface, peer) in [("l0", mac(i, 1)), ("r0", mac(i + 1, 2))] {
            let port = Port::ethernet(interface, &PortConfig::switch(Identity::generate("switch")?, LinkIds::new()))?;
            let found = port.interface().context("an Ethernet port has an interface")?.clone();
            planes.attach(&found, port.data())?;
            addresses.push(LinkAddr::Ethernet { ifindex: found.index, mac: peer });
            ports.push(port);
        }
        let (first, last) = (i == 0, i + 1 == hops);
        let own_bit = 1 << i;
        planes.set_own_bit(own_bit)?;
        planes.set_link(link(LEFT, first, (own_bit - 1, key(i)), (mac(i, 1), mac(i, 2))), addresses[0])?;
        let beyond = ((1 << hops) - 1) & !(own_bit | (own_bit - 1));
        planes.set_link(link(RIGHT, last, (beyond, key(i + 1)), (mac(i + 1, 2), mac(i + 1, 1))), addresses[1])?;
        if first || last {
            let readers = if last { vec![RIGHT] } else { vec![] };
            planes.set_route(TOPIC, &PlaneRoute { egress_bits: 1 << (hops - 1), readers, writers: vec![LEFT] })?;
        }
        let mut next_hops = [0; 64];
        (i + 1..hops).for_each(|bit| next_hops[bit] = RIGHT);
        planes.set_next_hops(&next_hops)?;
        drop(_runtime);
        Ok(Self { planes, _ports: ports, _runtime: runtime })
    }
}

/// A link with one key for both directions; the neighbour calls it LEFT, because frames go to the right.
fn link(
    id: u32,
    endpoint: bool,
    (reach, key): (u64, [u64; 2]),
    (peer_mac, local_mac): ([u8; 6], [u8; 6]),
) -> LinkEntry {
    LinkEntry {
        id,
        peer_id: LEFT,
        role: if endpoint { LinkRole::Endpoint } else { LinkRole::Switch } as u32,
        rx_keys: [key; 2],
        tx_keys: [key; 2],
        reach: if endpoint { 0 } else { reach },
        mtu: 1500,
        carrier: Carrier::ethernet(peer_mac, local_mac),
        ..LinkEntry::default()
    }
}

/// An IPv4 and UDP packet of `length` bytes with its Ethernet header, from the robot to the cloud.
fn ipv4(ethernet: [u8; 14], length: usize, hops: u8) -> Vec<u8> {
    let mut frame = ethernet.to_vec();
    let total = (length - 14) as u16;
    let mut ip = [0x45, 0, 0, 0, 0, 0, 0, 0, 64, 17, 0, 0, 10, 9, 0, 1, 10, 9, hops, 2];
    ip[2..4].copy_from_slice(&total.to_be_bytes());
    let sum: u32 = ip.chunks(2).map(|pair| u32::from(u16::from_be_bytes([pair[0], pair[1]]))).sum();
    let folded = (sum & 0xffff) + (sum >> 16);
    let checksum = !((folded & 0xffff) + (folded >> 16)) as u16;
    ip[10..12].copy_from_slice(&checksum.to_be_bytes());
    frame.extend(ip);
    frame.extend([0x7a, 0xb7, 0x7a, 0xb7]);
    frame.extend((total - 20).to_be_bytes());
    frame.extend([0, 0]); // no checksum
    frame.resize(length, 0x5a);
    frame
}

/// A veth takes redirected frames if its peer has GRO on; the kernel notices a change only while that peer is up.
fn refresh_gro(node: &Namespace) -> Result<()> {
    let links = node.ip(&["-o", "link"])?;
    for interface in ["l0", "r0"].iter().filter(|name| links.contains(&format!(" {name}@"))) {
        for state in ["off", "on"] {
            execute(node.command("ethtool")?.args(["-K", interface, "gro", state]))?;
        }
    }
    Ok(())
}

fn key(link: usize) -> [u64; 2] {
    [link as u64, 0x6764_7062_656e_6368]
}

/// As [`Chain`] gives them: link 0 is robot – s1, end 1 its left one.
fn mac(link: usize, end: u8) -> [u8; 6] {
    [2, 0, 0, 0, link as u8, end]
}

fn mac_text(link: usize, end: u8) -> String {
    mac(link, end).map(|byte| format!("{byte:02x}")).join(":")
}
