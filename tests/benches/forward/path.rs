//! A chain of switches of one kind, ready to carry frames from the robot's end to the cloud's.

use std::path::Path as FilePath;

use anyhow::{Context, Result, ensure};
use aya::maps::{DevMap, MapData};
use gdp::identity::Identity;
use gdp::link::LinkIds;
use gdp::port::{Interface, LinkAddr, Port, PortConfig};
use gdp_ctl::plane::{PlaneConfig, PlaneRoute, Planes, Wanted};
use gdp_tests::chain::{Chain, ChainOptions};
use gdp_tests::frames::Frame;
use gdp_tests::netns::{Entered, Namespace, execute};
use gdp_tests::packet::ETHERNET;
use gdp_wire::{Carrier, Counter, LinkEntry, LinkRole, Name};

use crate::Bench;
use crate::traffic::{Frames, Programs};

/// What forwards.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Nothing: a cable from the generator to the sink.
    Cable,
    /// An XDP program that does nothing but redirect.
    Bare,
    /// The XDP switch with a hop tag that costs nothing.
    Untagged,
    Xdp,
    /// The kernel's IPv4 routers.
    Ip,
    /// The userspace plane, on packet sockets.
    Userspace,
}

pub struct Path {
    kind: Kind,
    chain: Chain,
    switches: Vec<Switch>,
    _redirects: Vec<Redirect>,
}

struct Switch {
    planes: Planes,
    ports: Vec<Port>,
    runtime: tokio::runtime::Runtime,
}

/// A bare redirect from `l0` to `r0`.
struct Redirect {
    _programs: Programs,
    _out: DevMap<MapData>,
}

const TOPIC: Name = Name::from_bytes([0xd0; 32]);

/// The index, and so the id, of each switch's link to the left and to the right.
const LEFT: u32 = 1;
const RIGHT: u32 = 2;

/// Ethernet, IPv4 and UDP.
const UDP_HEADERS: usize = 14 + 20 + 8;

impl Path {
    pub fn build(kind: Kind, hops: usize, bench: &Bench) -> Result<Self> {
        let chain = Chain::build(ChainOptions { switches: hops, ..Default::default() })?;
        for node in chain.nodes() {
            refresh_gro(node)?;
        }
        let (mut switches, mut redirects) = (Vec::new(), Vec::new());
        for (i, namespace) in chain.switches().iter().enumerate() {
            match kind {
                Kind::Cable | Kind::Ip => {}
                Kind::Bare => redirects.push(Redirect::start(namespace, bench)?),
                Kind::Untagged => {
                    switches.push(Switch::start(namespace, Wanted::Xdp, &bench.untagged_object, i, hops)?)
                }
                Kind::Xdp => switches.push(Switch::start(namespace, Wanted::Xdp, &bench.ebpf_object, i, hops)?),
                Kind::Userspace => {
                    switches.push(Switch::start(namespace, Wanted::Userspace, &bench.ebpf_object, i, hops)?);
                }
            }
        }
        if kind == Kind::Ip {
            chain.become_ip_routers()?;
            let (_, cloud) = chain.ip_ends();
            // The sink drops what the cloud would answer ARP with only if it is long: this resolves the last hop.
            let last = &chain.switches()[hops - 1];
            last.ip(&["neigh", "replace", &cloud, "lladdr", &mac_text(hops, 2), "dev", "r0", "nud", "permanent"])?;
        }
        Ok(Self { kind, chain, switches, _redirects: redirects })
    }

    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    /// Where frames arrive that the robot sends: the first switch, or the cloud if there is none.
    pub fn first_hop(&self) -> &Namespace {
        &self.chain.nodes()[1]
    }

    /// Lets frames into the first switch by another interface. They come on the link that they name, as on any interface.
    pub fn attach_to_first_switch(&mut self, interface: &str) -> Result<()> {
        let switch = self.switches.first_mut().context("a path with switches")?;
        switch.attach(&self.chain.nodes()[1].enter()?, interface).map(drop)
    }

    fn hops(&self) -> usize {
        self.chain.switches().len()
    }

    /// What to send from the robot: frames of the same length for all kinds, and every one a GDP frame with its count and tag. The
    /// routers get it in UDP, with less payload.
    pub fn frames(&self, payload: usize) -> Frames {
        let around = if self.kind == Kind::Ip { UDP_HEADERS - ETHERNET } else { 0 };
        let frame = Frame {
            to_mac: mac(0, 2),
            from_mac: mac(0, 1),
            link_id: LEFT,
            destination: TOPIC.to_bytes(),
            payload: vec![0x5a; payload - around],
            ..Frame::default()
        };
        let bytes = match self.kind {
            Kind::Ip => in_udp(&frame, self.hops() as u8),
            _ => frame.bytes(),
        };
        Frames {
            frame: bytes,
            header_at: ETHERNET + around,
            link: LinkEntry { id: LEFT, peer_id: LEFT, tx_keys: [key(0); 2], ..LinkEntry::default() },
            tagged: self.kind != Kind::Untagged,
        }
    }

    /// The frames took the way that was to be measured, and no other. `may`: drops that belong to the measurement.
    pub fn check(&self, may: Option<Counter>) -> Result<()> {
        for (i, switch) in self.switches.iter().enumerate() {
            let last = i + 1 == self.switches.len();
            let expected = if last { Counter::Delivered } else { Counter::Forwarded };
            for (counter, kernel, userspace) in switch.planes.counters()? {
                let (ours, other) =
                    if self.kind == Kind::Userspace { (userspace, kernel) } else { (kernel, userspace) };
                let fine = if counter == expected {
                    ours > 0 && other == 0
                } else {
                    !counter.is_drop() || ours == 0 || may == Some(counter)
                };
                ensure!(fine, "s{}: {} is {kernel} in the kernel, {userspace} in userspace", i + 1, counter.as_str());
            }
        }
        Ok(())
    }
}

impl Redirect {
    fn start(at: &Namespace, bench: &Bench) -> Result<Self> {
        let _inside = at.enter()?;
        let mut programs = Programs::load(&bench.bench_object, &["bare"])?;
        let mut out: DevMap<MapData> = programs.map("OUT")?;
        out.set(0, Interface::find("r0")?.index, None, 0)?;
        programs.attach("bare", "l0")?;
        Ok(Self { _programs: programs, _out: out })
    }
}

impl Switch {
    fn start(at: &Namespace, wanted: Wanted, ebpf_object: &FilePath, i: usize, hops: usize) -> Result<Self> {
        let inside = at.enter()?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let within = runtime.enter();
        let config = PlaneConfig { wanted, ebpf_object: Some(ebpf_object.into()), ..Default::default() };
        let planes = Planes::open(config)?;
        drop(within);
        let mut switch = Self { planes, ports: Vec::new(), runtime };
        let mut addresses = Vec::new();
        for (interface, peer) in [("l0", mac(i, 1)), ("r0", mac(i + 1, 2))] {
            addresses.push(LinkAddr::Ethernet { ifindex: switch.attach(&inside, interface)?, mac: peer });
        }
        let planes = &mut switch.planes;
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
        Ok(switch)
    }

    /// Takes over what arrives on an interface of the network namespace that the calling thread is in; its index.
    fn attach(&mut self, _inside: &Entered, interface: &str) -> Result<u32> {
        let _within = self.runtime.enter();
        let port = Port::ethernet(interface, &PortConfig::switch(Identity::generate("switch")?, LinkIds::new()))?;
        let found = port.interface().context("an Ethernet port has an interface")?.clone();
        self.planes.attach(&found, port.data())?;
        self.ports.push(port);
        Ok(found.index)
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

/// The frame in UDP over IPv4, from the robot to the cloud.
fn in_udp(frame: &Frame, hops: u8) -> Vec<u8> {
    let gdp = &frame.bytes()[ETHERNET..];
    let mut packet = Frame { ethertype: 0x0800, ..frame.clone() }.ethernet().to_vec();
    let total = (20 + 8 + gdp.len()) as u16;
    let mut ip = [0x45, 0, 0, 0, 0, 0, 0, 0, 64, 17, 0, 0, 10, 9, 0, 1, 10, 9, hops, 2];
    ip[2..4].copy_from_slice(&total.to_be_bytes());
    let sum: u32 = ip.chunks(2).map(|pair| u32::from(u16::from_be_bytes([pair[0], pair[1]]))).sum();
    let folded = (sum & 0xffff) + (sum >> 16);
    let checksum = !((folded & 0xffff) + (folded >> 16)) as u16;
    ip[10..12].copy_from_slice(&checksum.to_be_bytes());
    packet.extend(ip);
    packet.extend([gdp_wire::UDP_PORT.to_be_bytes(), gdp_wire::UDP_PORT.to_be_bytes()].concat());
    packet.extend((total - 20).to_be_bytes());
    packet.extend([0, 0]); // no checksum
    packet.extend(gdp);
    packet
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
