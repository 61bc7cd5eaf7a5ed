//! A chain of switches of one kind that carries frames from the robot to the cloud.

use std::cell::RefCell;

use anyhow::{Context, Result};
use aya::maps::{DevMap, MapData};
use gdp_dataplane::Wanted;
use gdp_link::port::Interface;
use gdp_tests::chain::{Chain, ChainOptions};
use gdp_tests::frames::Frame;
use gdp_tests::frames::carrier::Carrier;
use gdp_tests::netns::{Namespace, execute};
use gdp_tests::programs::Program;
use gdp_wire::{Counter, Header, LinkEntry};

use crate::Bench;
use crate::switch::{LEFT, Medium, Position, Switch, TOPIC, key, know_neighbour, link_ip, link_socket, mac};
use crate::testpmd::Testpmd;
use crate::traffic::{Frames, Programs, Spread};

/// The kind of forwarder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// No forwarder: a cable from the generator to the sink.
    Cable,
    /// An XDP program that only redirects.
    Bare,
    /// The XDP switch with a hop tag that costs nothing.
    Untagged,
    Xdp,
    /// The XDP switch, where another name's copies leave on the same interfaces.
    Forking,
    /// The kernel's IPv4 routers.
    Ip,
    /// The userspace plane, on packet sockets.
    Userspace,
    /// The DPDK plane with this driver.
    Dpdk(&'static str),
    /// DPDK's own forwarder with this driver.
    Testpmd(&'static str),
}

pub struct Path {
    kind: Kind,
    chain: Chain,
    /// Encapsulation of frames from the robot.
    carrier: Carrier,
    switches: Vec<Switch>,
    testpmd: RefCell<Option<Testpmd>>,
    _redirects: Vec<Redirect>,
}

/// A bare redirect from `l0` to `r0`.
struct Redirect {
    _programs: Programs,
    _out: DevMap<MapData>,
}

impl Path {
    pub fn build(kind: Kind, hops: usize, bench: &Bench) -> Result<Self> {
        Self::of(kind, hops, [Medium::Ethernet; 2], bench)
    }

    /// Builds one XDP switch between links of two kinds.
    pub fn crossing(media: [Medium; 2], bench: &Bench) -> Result<Self> {
        Self::of(Kind::Xdp, 1, media, bench)
    }

    fn of(kind: Kind, hops: usize, media: [Medium; 2], bench: &Bench) -> Result<Self> {
        let chain = Chain::build(ChainOptions { switches: hops, ..Default::default() })?;
        for node in chain.nodes() {
            refresh_gro(node)?;
        }
        let (mut switches, mut redirects, mut testpmd) = (Vec::new(), Vec::new(), None);
        for (index, namespace) in chain.switches().iter().enumerate() {
            let (wanted, object) = match kind {
                Kind::Cable | Kind::Ip => continue,
                Kind::Bare => {
                    redirects.push(Redirect::start(namespace, bench)?);
                    continue;
                }
                Kind::Untagged => (Wanted::Xdp, &bench.untagged_object),
                Kind::Xdp | Kind::Forking => (Wanted::Xdp, &bench.ebpf_object),
                Kind::Userspace => (Wanted::Userspace, &bench.ebpf_object),
                Kind::Dpdk(_) => (Wanted::Dpdk, &bench.ebpf_object),
                Kind::Testpmd(driver) => {
                    let devices = [("0", "l0"), ("1", "r0")].map(|(i, name)| format!("{driver}{i},iface={name}"));
                    testpmd = Some(Testpmd::start(|program| namespace.command(program), &devices)?);
                    continue;
                }
            };
            let driver = if let Kind::Dpdk(driver) = kind { Some(driver) } else { None };
            let mut switch = Switch::start(namespace, wanted, (object, driver), Position { index, hops, media })?;
            if kind == Kind::Forking {
                switch.copy_another_name(&namespace.enter()?)?;
            }
            switches.push(switch);
        }
        if kind == Kind::Ip {
            chain.become_ip_routers()?;
            // Resolves the last hop statically. The sink passes only short frames to the cloud's
            // stack, ARP among them.
            know_neighbour(&chain.switches()[hops - 1], "r0", link_ip(Medium::Udp4, hops, 2), mac(hops, 2))?;
        }
        let udp = |medium, to| Carrier::Udp { from: link_socket(medium, 0, 1), to, class: 0 };
        let carrier = match (kind, media[0]) {
            (Kind::Ip, _) => udp(Medium::Udp4, link_socket(Medium::Udp4, hops, 2)),
            (_, Medium::Ethernet) => Carrier::Ethernet,
            (_, medium) => udp(medium, link_socket(medium, 0, 2)),
        };
        let testpmd = RefCell::new(testpmd);
        Ok(Self { kind, chain, carrier, switches, testpmd, _redirects: redirects })
    }

    /// Runs a closure while testpmd forwards, if this path uses testpmd.
    pub fn while_it_runs<T>(&self, measure: impl FnOnce() -> T) -> T {
        match &mut *self.testpmd.borrow_mut() {
            Some(testpmd) => testpmd.during(|_| measure()),
            None => measure(),
        }
    }

    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    /// Returns the first receiver of the robot's frames: the first switch, or the cloud if there is
    /// none.
    pub fn first_hop(&self) -> &Namespace {
        &self.chain.nodes()[1]
    }

    /// Attaches another interface to the first switch. The frames' link ids select their link, as
    /// on any interface.
    pub fn attach_to_first_switch(&mut self, interface: &str) -> Result<()> {
        let switch = self.switches.first_mut().context("a path with switches")?;
        switch.attach(&self.chain.nodes()[1].enter()?, interface).map(drop)
    }

    /// Returns the frames that the robot sends, with packets of this length. GDP frames have
    /// counters and tags even if no switch checks them.
    pub fn frames(&self, length: usize) -> Frames {
        let header_at = self.around();
        let frame = Frame {
            to_mac: mac(0, 2),
            from_mac: mac(0, 1),
            carrier: self.carrier,
            link_id: LEFT,
            destination: TOPIC.to_bytes(),
            payload: vec![0x5a; length - header_at - Header::LEN],
            ..Frame::default()
        };
        Frames {
            frame: frame.bytes(),
            header_at,
            link: LinkEntry { id: LEFT, peer_id: LEFT, tx_keys: [key(0); 2], ..LinkEntry::default() },
            tagged: self.kind != Kind::Untagged,
            spread: Spread::SINGLE,
        }
    }

    /// Returns the bytes in front of a GDP frame from the robot.
    pub fn around(&self) -> usize {
        self.carrier.carry([0; 6], [0; 6], 0, &[]).len()
    }

    /// Fails unless the frames took the path under measurement and no other. `may`: a drop reason
    /// that belongs to the measurement.
    pub fn check(&self, may: Option<Counter>) -> Result<()> {
        for (i, switch) in self.switches.iter().enumerate() {
            let expected = if i + 1 == self.switches.len() { Counter::Delivered } else { Counter::Forwarded };
            let checked = switch.check(expected, self.kind != Kind::Userspace, may);
            checked.with_context(|| format!("s{}", i + 1))?;
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

/// Toggles GRO. A veth accepts redirected frames if its peer has GRO on; the kernel notices a
/// change only while that peer is up.
pub fn refresh_gro(node: &Namespace) -> Result<()> {
    let links = node.ip(&["-o", "link"])?;
    for interface in ["l0", "r0"].iter().filter(|name| links.contains(&format!(" {name}@"))) {
        for state in ["off", "on"] {
            execute(node.command(Program::Ethtool)?.args(["-K", interface, "gro", state]))?;
        }
    }
    Ok(())
}
