//! The one topology that tests, the demo and benchmarks share:
//!
//! ```text
//!  robot r0 ── l0 s1 r0 ── l0 s2 r0 ── l0 s3 r0 ── l0 cloud
//!                        ▲
//!                       wire   (optional, on any link: a kernel bridge, where an eavesdropper or attacker sits)
//! ```
//!
//! The chain consists of cables alone: no addresses, no programs. Every node names its left
//! interface `l0` and its right one `r0`.

use anyhow::{Context, Result};
use gdp_faults::Faults;

use crate::bridge::{self, BridgedCable};
use crate::netns::{self, End, Namespace, veth};
use crate::packet::PacketSocket;
use crate::wire::Wire;

/// The length of the chain and the properties of its cables.
#[derive(Clone, Copy, Debug)]
pub struct ChainOptions {
    /// Switches between robot and cloud.
    pub switches: usize,
    /// MTU of every interface, in bytes.
    pub mtu: u32,
    /// The link (0 is robot – s1) that carries the wire.
    pub wire: Option<usize>,
    /// Whether interfaces leave checksums and segmentation to the (virtual) hardware.
    pub transmit_offloads: bool,
}

impl Default for ChainOptions {
    fn default() -> Self {
        Self { switches: 3, mtu: 1500, wire: None, transmit_offloads: false }
    }
}

impl ChainOptions {
    /// Returns the address of the left neighbour of node `i` and the port of its switch, after
    /// [`Chain::become_ip_routers`]. Node 0 is the robot.
    pub fn left_of(&self, i: usize) -> String {
        format!("10.9.{}.1:{GDP_PORT}", i - 1)
    }

    /// Returns the address of the right neighbour of node `i`, as [`Self::left_of`] does.
    pub fn right_of(&self, i: usize) -> String {
        format!("10.9.{i}.2:{GDP_PORT}")
    }
}

/// The UDP port of switches.
pub const GDP_PORT: u16 = 31415;

/// A chain of namespaces. Dropping it deletes them.
pub struct Chain {
    nodes: Vec<Namespace>,
    wire: Option<BridgedCable>,
}

impl Chain {
    pub fn build(options: ChainOptions) -> Result<Self> {
        let last = options.switches + 1;
        let label = |i| match i {
            0 => "robot".to_owned(),
            i if i == last => "cloud".to_owned(),
            i => format!("s{i}"),
        };
        let nodes = (0..=last).map(|i| Namespace::create(&label(i))).collect::<Result<Vec<_>>>()?;
        let mut wire = None;
        for link in 0..last {
            let left = End { namespace: &nodes[link], interface: "r0", mac: mac(link, 1) };
            let right = End { namespace: &nodes[link + 1], interface: "l0", mac: mac(link, 2) };
            match options.wire == Some(link) {
                true => wire = Some(BridgedCable::lay(&left, &right, options.mtu)?),
                false => veth(&left, &right, options.mtu)?,
            }
            if options.transmit_offloads {
                [left, right].iter().try_for_each(netns::enable_transmit_offloads)?;
            }
        }
        Ok(Self { nodes, wire })
    }

    /// Returns the nodes in the order robot, switches, cloud.
    pub fn nodes(&self) -> &[Namespace] {
        &self.nodes
    }

    pub fn robot(&self) -> &Namespace {
        &self.nodes[0]
    }

    pub fn cloud(&self) -> &Namespace {
        &self.nodes[self.nodes.len() - 1]
    }

    pub fn switches(&self) -> &[Namespace] {
        &self.nodes[1..self.nodes.len() - 1]
    }

    /// Opens the robot's side of the wire. The socket receives frames from the robot; frames sent
    /// on it return to the robot's side.
    pub fn wire_from_robot(&self) -> Result<PacketSocket> {
        PacketSocket::open(self.wire()?, bridge::LEFT)
    }

    /// Opens the cloud's side of the wire. The socket receives frames from the cloud; frames sent
    /// on it continue toward the cloud.
    pub fn wire_to_cloud(&self) -> Result<PacketSocket> {
        PacketSocket::open(self.wire()?, bridge::RIGHT)
    }

    /// Blocks every frame on the wire, or lets all frames pass again.
    pub fn cut_wire(&self, cut: bool) -> Result<()> {
        self.cable()?.cut(cut)
    }

    /// Applies link faults to the wire until the returned guard is dropped. Dropping the guard cuts
    /// the wire. `faults`: toward the cloud, toward the robot.
    pub fn disturb_wire(&self, faults: [Faults; 2], seed: u64) -> Result<Wire> {
        let at = self.wire()?;
        for port in [bridge::LEFT, bridge::RIGHT] {
            at.ip(&["link", "set", port, "nomaster"])?;
        }
        Wire::start(at, [bridge::LEFT, bridge::RIGHT], faults, seed)
    }

    /// Returns the namespace of the wire, and an interface in it that reaches both ends of the
    /// wire.
    pub fn on_the_wire(&self) -> Result<(&Namespace, &'static str)> {
        Ok((self.wire()?, bridge::BRIDGE))
    }

    /// Assigns every interface an address (`10.9.LINK.1` left, `.2` right) and makes the switches
    /// plain IP routers.
    pub fn become_ip_routers(&self) -> Result<()> {
        let last = self.nodes.len() - 1;
        for (i, node) in self.nodes.iter().enumerate() {
            if i > 0 {
                node.ip(&["addr", "add", &format!("10.9.{}.2/24", i - 1), "dev", "l0"])?;
            }
            if i < last {
                node.ip(&["addr", "add", &format!("10.9.{i}.1/24"), "dev", "r0"])?;
            }
            if i > 0 && i < last {
                let _inside = node.enter()?;
                std::fs::write("/proc/sys/net/ipv4/ip_forward", "1").context("cannot turn on IP forwarding")?;
            }
            for subnet in 0..last {
                let to = format!("10.9.{subnet}.0/24");
                if subnet > i {
                    node.ip(&["route", "add", &to, "via", &format!("10.9.{i}.2")])?;
                } else if subnet + 1 < i {
                    node.ip(&["route", "add", &to, "via", &format!("10.9.{}.1", i - 1)])?;
                }
            }
        }
        Ok(())
    }

    /// Returns the addresses of robot and cloud after [`Chain::become_ip_routers`].
    pub fn ip_ends(&self) -> (String, String) {
        ("10.9.0.1".to_owned(), format!("10.9.{}.2", self.nodes.len() - 2))
    }

    fn wire(&self) -> Result<&Namespace> {
        self.cable().map(BridgedCable::namespace)
    }

    fn cable(&self) -> Result<&BridgedCable> {
        self.wire.as_ref().context("this chain was built without a wire")
    }
}

fn mac(link: usize, end: u8) -> [u8; 6] {
    [0x02, 0, 0, 0, link as u8, end]
}
