//! Frames copied to links over UDP and to others at the same time. Every copy is compared byte for
//! byte on the cable, counted, and captured again behind a router.
//!
//! ```text
//!   far:w0 ──── p0 ┐        ┌ r0 ──── s0 ┐
//!                  ├ switch ┤            ├ router:c0 ──── e0:cloud
//!   far:w1 ──── p1 ┘        └ r1 ──── s1 ┘
//!        Ethernet             10.1.0.1                 UDP, all at 10.9.0.9 and 2001:db8:9::9,
//!                             10.2.0.1                 each at a port of its own
//! ```

use std::collections::HashMap;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use gdp_core::identity::Identity;
use gdp_dataplane::kernel::pinned_stats;
use gdp_dataplane::{PinLocation, PlaneConfig, pins};
use gdp_link::link::LinkIds;
use gdp_link::port::{LinkAddr, Port, PortConfig};
use gdp_tests::Tools;
use gdp_tests::fabric::Mounted;
use gdp_tests::frames::{Frame, carrier};
use gdp_tests::netns::{Door, End, Namespace, execute, veth};
use gdp_tests::packet::PacketSocket;
use gdp_tests::process::Process;
use gdp_tests::programs::Program;
use gdp_tests::wait::{TIMEOUT, wait_for};
use gdp_wire::table::ip_words;
use gdp_wire::{Carrier, Counter, LinkEntry, Name};
use parking_lot::Mutex;
use tokio::runtime::Runtime;

use crate::star::{Far, Leaf, OWN_BIT, Plane, Star, Switch, WRITER, check_copy, xdp};

const TOPIC: Name = Name::from_bytes([0xd0; 32]);
const OTHER: Name = Name::from_bytes([0xe0; 32]);

const ETHERNETS: usize = 2;
const PORT: u16 = 31415;
const FRAMES: u64 = 50;
/// The largest frame in a datagram on these cables, with a margin.
const MTU: u32 = 1400;

#[test]
fn readers_over_ipv4_behind_one_interface() -> Result<()> {
    for count in [2, 8, 64] {
        copies_to(count, Over::Udp4).with_context(|| format!("{count} readers"))?;
    }
    Ok(())
}

#[test]
fn readers_over_ipv6_behind_one_interface() -> Result<()> {
    for count in [2, 64] {
        copies_to(count, Over::Udp6).with_context(|| format!("{count} readers"))?;
    }
    Ok(())
}

/// Readers and neighbouring switches over all media; each gets its own egress bits.
#[test]
fn readers_and_neighbours_over_ethernet_and_both_kinds_of_udp() -> Result<()> {
    let readers = [peer(2, Over::Ethernet(0), 0), peer(3, Over::Ethernet(1), 0), peer(4, Over::Udp4, 0)];
    let readers = [&readers[..], &[peer(5, Over::Udp4, 0), peer(6, Over::Udp6, 0)]].concat();
    let [north, east, south] =
        [(7, Over::Ethernet(1)), (8, Over::Udp4), (9, Over::Udp6)].map(|(index, over)| peer(index, over, 1 << index));
    let mut site = Site::build(&[&readers[..], &[north, east, south]].concat())?;
    site.switch.set_route(TOPIC, OWN_BIT | east.leaf.reach, &leaves(&readers))?;
    site.exchange(Plane::Kernel, &onto(&readers).into_iter().chain([(east, east.leaf.reach)]).collect::<Vec<_>>())?;

    site.switch.set_route(OTHER, north.leaf.reach | south.leaf.reach, &[])?;
    site.exchange_to(Plane::Kernel, OTHER, &[(north, north.leaf.reach), (south, south.leaf.reach)])
}

/// The writer's link is in the group, and behind the same interface as the others.
#[test]
fn the_link_that_a_frame_came_by_gets_no_copy() -> Result<()> {
    let writer = peer(1, Over::Udp4, 0);
    let readers = [peer(2, Over::Udp4, 0), peer(3, Over::Udp6, 0), peer(4, Over::Ethernet(1), 0)];
    let mut site = Site::build(&readers)?;
    site.set_link(&writer)?;
    site.switch.set_route(TOPIC, OWN_BIT, &leaves(&[&[writer], &readers[..]].concat()))?;
    site.writer = writer;
    site.exchange(Plane::Kernel, &onto(&readers))
}

/// After a route change, one frame or the few in flight do not reach the changed links. Then the
/// userspace plane makes the copies until the kernel's groups have followed.
#[test]
fn a_changed_route_is_followed() -> Result<()> {
    let ethernet = peer(2, Over::Ethernet(1), 0);
    let readers = [ethernet, peer(3, Over::Udp4, 0), peer(4, Over::Udp4, 0), peer(5, Over::Udp6, 0)];
    let mut site = Site::build(&readers)?;
    site.switch.set_route(TOPIC, OWN_BIT, &leaves(&readers))?;
    site.exchange(Plane::Kernel, &onto(&readers))?;

    site.outside.star.switch.ip(&["route", "replace", "10.9.0.0/24", "via", "10.2.0.254"])?;
    let lost = site.far.next_frame(&WRITER, TOPIC, 600);
    site.far.send(&lost)?;
    site.far.wait_for_frames(&[ethernet.leaf], 1).context("nobody else's copy is lost")?;
    wait_for("the copies that found no way", TIMEOUT, || {
        Ok((site.switch.count(Counter::RedirectFailed)? == (2, 0)).then_some(()))
    })
    .with_context(|| format!("{:?}", site.switch.counted()))?;
    site.wait_for(&[readers[3]], 1).context("its route did not change")?;
    site.take();

    site.ways = [1, 0];
    site.exchange(Plane::Userspace, &onto(&readers)).context("before the groups follow")?;
    site.refresh()?;
    site.exchange(Plane::Kernel, &onto(&readers)).context("after")
}

/// The router's neighbour entry may have expired.
#[test]
fn an_unresolved_router_is_resolved_by_the_userspace_plane() -> Result<()> {
    let readers = [peer(2, Over::Ethernet(1), 0), peer(3, Over::Udp4, 0), peer(4, Over::Udp6, 0)];
    let mut site = Site::build(&readers)?;
    site.switch.set_route(TOPIC, OWN_BIT, &leaves(&readers))?;
    site.outside.star.switch.ip(&["neigh", "flush", "dev", "r0"])?;
    site.refresh()?;
    site.exchange(Plane::Userspace, &onto(&readers))?;
    site.refresh()?;
    site.exchange(Plane::Kernel, &onto(&readers))
}

/// A peer's NAT changes its port, and later the peer returns on Ethernet.
#[test]
fn a_reader_moves() -> Result<()> {
    let mut readers = [peer(2, Over::Udp4, 0), peer(3, Over::Udp4, 0), peer(4, Over::Udp6, 0)];
    let mut site = Site::build(&readers)?;
    site.switch.set_route(TOPIC, OWN_BIT, &leaves(&readers))?;
    site.exchange(Plane::Kernel, &onto(&readers))?;
    for (port, over) in [(777, Over::Udp4), (778, Over::Udp6), (0, Over::Ethernet(1)), (779, Over::Udp4)] {
        readers[1] = Peer { over, port, ..peer(3, over, 0) };
        site.set_link(&readers[1])?;
        site.exchange(Plane::Kernel, &onto(&readers)).with_context(|| format!("by {over:?} {port}"))?;
    }
    Ok(())
}

/// A daemon is killed and a successor follows: the kernel continues to copy to the same group.
#[test]
fn no_copy_is_lost_when_the_switch_is_killed_and_comes_again() -> Result<()> {
    let readers = process_readers();
    let site = Outside::build()?;
    let folder = tempfile::tempdir()?;
    let bpffs = Mounted(folder.path().join(BPFFS));
    let mut far = Far::start(&site.star)?;
    let routed = Routed::start(&site.router, &site.cloud)?;
    let mut sent = 0;
    let mut traffic = |more: &mut dyn FnMut(u64) -> Result<bool>| -> Result<()> {
        let begun = sent;
        while more(sent - begun)? {
            let frame = far.next_frame(&WRITER, TOPIC, 600);
            far.send(&frame)?;
            sent += 1;
            wait_for(&format!("frame {sent}"), TIMEOUT, || {
                let slowest = readers.iter().map(|peer| routed.received(peer.leaf.peer_id())).min();
                Ok((slowest >= Some(sent) && far.received(&PROCESS_READER) >= sent).then_some(()))
            })?;
        }
        Ok(())
    };
    let start = |label: &str| -> Result<Process> {
        let mut command = site.star.switch.command(std::env::current_exe()?)?;
        command.args(["--exact", "replication_udp::switch_process", "--nocapture"]).env(SWITCH_PROCESS, folder.path());
        Process::spawn(label, command, folder.path())
    };
    let is_up = |process: &mut Process| -> Result<bool> {
        process.check_alive()?;
        Ok(!process.json_lines().is_empty())
    };
    let mut process = start("first")?;
    wait_for("the switch", TIMEOUT, || Ok(is_up(&mut process)?.then_some(())))?;
    traffic(&mut |frames| Ok(frames < 100))?;
    process.kill()?;
    traffic(&mut |frames| Ok(frames < 100)).context("without a daemon")?;
    let mut process = start("second")?;
    traffic(&mut |_| Ok(!is_up(&mut process)?)).context("while the second came")?;
    traffic(&mut |frames| Ok(frames < 100)).context("with the second")?;

    let pins = pins::find(&bpffs.0)?.pop().context("pins")?;
    let counted = pinned_stats(&pins.folder)?.counters;
    let of = |wanted| counted.iter().find(|(counter, _)| *counter == wanted).map(|(_, count)| *count);
    ensure!(of(Counter::Replicated) == Some(sent) && of(Counter::Slow) == Some(0), "{counted:?}");
    ensure!(of(Counter::Delivered) == Some(sent * (readers.len() as u64 + 1)), "a copy twice: {counted:?}");
    Ok(())
}

/// Variable with the folder of the process, which does nothing without it.
const SWITCH_PROCESS: &str = "GDP_TEST_SWITCH_PROCESS";
const BPFFS: &str = "bpf";
const PROCESS_READER: Leaf = Leaf { index: 2, interface: 1, reach: 0 };

/// Returns the process's readers over UDP; the other reader is [`PROCESS_READER`].
fn process_readers() -> [Peer; 3] {
    [peer(3, Over::Udp4, 0), peer(4, Over::Udp4, 0), peer(5, Over::Udp6, 0)]
}

/// The process that the test above kills; not a test itself.
#[test]
fn switch_process() -> Result<()> {
    let Some(folder) = std::env::var_os(SWITCH_PROCESS) else { return Ok(()) };
    let pins = PinLocation { bpffs: PathBuf::from(folder).join(BPFFS), switch: TOPIC, replaces: false };
    let config = PlaneConfig { pins: Some(pins), ..xdp(Tools::beside_this_test()?.ebpf_object()?) };
    let mut switch = Switch::open(config, Door::here()?, ETHERNETS)?;
    let is_first = switch.planes().left().is_none();
    let _udp = attach_udp(&mut switch)?;
    if is_first {
        switch.change(|planes| planes.set_own_bit(OWN_BIT))??;
        switch.set_link(&WRITER, MTU)?;
        switch.set_link(&PROCESS_READER, MTU)?;
        process_readers().iter().try_for_each(|peer| set_link(&mut switch, peer))?;
        switch.set_route(TOPIC, OWN_BIT, &[&[PROCESS_READER], &leaves(&process_readers())[..]].concat())?;
    }
    println!("\n{{\"first\": {is_first}}}");
    loop {
        std::thread::park();
    }
}

fn copies_to(count: u32, over: Over) -> Result<()> {
    let readers: Vec<Peer> = (0..count).map(|i| peer(2 + i, over, 0)).collect();
    let mut site = Site::build(&readers)?;
    site.switch.set_route(TOPIC, OWN_BIT, &leaves(&readers))?;
    site.exchange(Plane::Kernel, &onto(&readers))
}

/// The peer of a link, and its medium.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Peer {
    leaf: Leaf,
    over: Over,
    /// UDP port.
    port: u16,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Over {
    /// Ethernet on this interface.
    Ethernet(usize),
    Udp4,
    Udp6,
}

fn peer(index: u32, over: Over, reach: u64) -> Peer {
    let interface = if let Over::Ethernet(interface) = over { interface } else { 0 };
    Peer { leaf: Leaf { index, interface, reach }, over, port: 2000 + index as u16 }
}

impl Peer {
    /// Returns the addresses of the switch and of the peer.
    fn addresses(&self) -> Option<[SocketAddr; 2]> {
        let [switch, peer] = match self.over {
            Over::Ethernet(_) => return None,
            Over::Udp4 => ["10.1.0.1", "10.9.0.9"],
            Over::Udp6 => ["2001:db8:1::1", "2001:db8:9::9"],
        };
        let address = |ip: &str, port| SocketAddr::new(ip.parse().expect("an address"), port);
        Some([address(switch, PORT), address(peer, self.port)])
    }

    fn entry(&self) -> LinkEntry {
        let entry = self.leaf.entry(MTU);
        let Some([switch, peer]) = self.addresses() else { return entry };
        let ((kind, local_ip), (_, peer_ip)) = (ip_words(switch.ip()), ip_words(peer.ip()));
        let [local_port, peer_port] = [switch.port().to_be(), peer.port().to_be()];
        let flags = Carrier::ZERO_CHECKSUM;
        let carrier = Carrier { kind, flags, local_ip, local_port, peer_ip, peer_port, ..Carrier::default() };
        LinkEntry { carrier, ..entry }
    }

    /// Returns the offset of the GDP frame in a packet.
    fn at(&self) -> usize {
        match self.over {
            Over::Ethernet(_) => 14,
            Over::Udp4 => 42,
            Over::Udp6 => 62,
        }
    }
}

fn leaves(peers: &[Peer]) -> Vec<Leaf> {
    peers.iter().map(|peer| peer.leaf).collect()
}

/// Returns these peers as readers.
fn onto(peers: &[Peer]) -> Vec<(Peer, u64)> {
    peers.iter().map(|peer| (*peer, 0)).collect()
}

struct Site {
    // Fields drop in this order.
    switch: Switch,
    far: Far,
    routed: Routed,
    /// Sends as if from behind the router.
    uplink: PacketSocket,
    writer: Peer,
    /// The router's ingress interfaces for frames over IPv4 and over IPv6.
    ways: [usize; 2],
    _udp: (Port, Runtime),
    outside: Outside,
}

/// The networks around the switch.
struct Outside {
    star: Star,
    router: Namespace,
    cloud: Namespace,
}

impl Outside {
    fn build() -> Result<Self> {
        let star = Star::build(ETHERNETS, 1500)?;
        let [router, cloud] = ["router", "cloud"].map(Namespace::create);
        let outside = Self { star, router: router?, cloud: cloud? };
        build_routes(&outside.star.switch, &outside.router, &outside.cloud)?;
        Ok(outside)
    }
}

/// Attaches a switch to UDP. Call this in the switch's namespace.
fn attach_udp(switch: &mut Switch) -> Result<(Port, Runtime)> {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
    let port = {
        let _runtime = runtime.enter();
        let config = PortConfig::switch(Identity::generate("switch")?, LinkIds::new());
        Port::udp(SocketAddr::new([0u16; 8].into(), PORT), &config)?
    };
    let bound = port.udp_addr().context("an address")?;
    let reports = switch.change(|planes| planes.attach_udp(port.data(), bound, None))??;
    ensure!(reports.len() == 2 && reports.iter().all(|report| report.kind == "xdp-native"), "{reports:?}");
    Ok((port, runtime))
}

fn set_link(switch: &mut Switch, peer: &Peer) -> Result<()> {
    let Some([_, address]) = peer.addresses() else { return switch.set_link(&peer.leaf, MTU) };
    Ok(switch.change(|planes| planes.set_link(peer.entry(), LinkAddr::udp(address)))??)
}

impl Site {
    /// Builds a site with the writer's link on Ethernet and links to these peers.
    fn build(peers: &[Peer]) -> Result<Self> {
        let outside = Outside::build()?;
        let mut switch = outside.star.start(xdp(Tools::beside_this_test()?.ebpf_object()?), &[WRITER])?;
        let _udp = {
            let _inside = outside.star.switch.enter()?;
            attach_udp(&mut switch)?
        };
        let far = Far::start(&outside.star)?;
        let routed = Routed::start(&outside.router, &outside.cloud)?;
        let uplink = PacketSocket::open(&outside.router, "s0")?;
        let writer = Peer { leaf: WRITER, ..peer(1, Over::Ethernet(0), 0) };
        let mut site = Self { switch, far, routed, uplink, writer, ways: [0, 0], _udp, outside };
        peers.iter().try_for_each(|peer| site.set_link(peer))?;
        Ok(site)
    }

    fn set_link(&mut self, peer: &Peer) -> Result<()> {
        set_link(&mut self.switch, peer)
    }

    fn refresh(&mut self) -> Result<()> {
        Ok(self.switch.change(|planes| planes.refresh())??)
    }

    fn exchange(&mut self, plane: Plane, expected: &[(Peer, u64)]) -> Result<()> {
        self.exchange_to(plane, TOPIC, expected)
    }

    /// Sends frames. Each expected peer must get each of them, with these egress bits and from that
    /// plane. No other peer may get any.
    fn exchange_to(&mut self, plane: Plane, to: Name, expected: &[(Peer, u64)]) -> Result<()> {
        let counters = [Counter::Replicated, Counter::Delivered, Counter::Forwarded];
        let before = counters.map(|counter| self.switch.count(counter));
        let peers: Vec<Peer> = expected.iter().map(|(peer, _)| *peer).collect();
        let mut sent = Vec::new();
        for i in 0..FRAMES {
            sent.push(self.send(to, MTU as usize)?);
            // Fewer frames are in flight than the rings on the path have room for, with all copies
            // in one ring.
            self.wait_for(&peers, i.saturating_sub(2))?;
        }
        self.wait_for(&peers, FRAMES)?;
        let mut got = self.take();
        for (peer, bits) in expected {
            let got = got.remove(&peer.leaf.peer_id()).unwrap_or_default();
            ensure!(got.len() == sent.len(), "{peer:?} got {}", got.len());
            for (copy, sent) in got.iter().zip(&sent) {
                self.check_copy(plane, copy, sent, peer, *bits)?;
            }
        }
        ensure!(got.is_empty(), "nothing was for {:x?}", got.keys());

        let switches = peers.iter().filter(|peer| peer.leaf.reach != 0).count() as u64;
        let copies = [1, peers.len() as u64 - switches, switches];
        for ((counter, before), copies) in counters.into_iter().zip(before).zip(copies) {
            let before = before?;
            let wanted = if plane == Plane::Kernel { (copies * FRAMES, 0) } else { (0, copies * FRAMES) };
            // The userspace plane counts a frame after sending it, so the frame may arrive earlier.
            wait_for(&format!("{counter:?} to grow by {wanted:?}"), TIMEOUT, || {
                let after = self.switch.count(counter)?;
                Ok(((after.0 - before.0, after.1 - before.1) == wanted).then_some(()))
            })
            .with_context(|| format!("{:?}", self.switch.counted()))?;
        }
        Ok(())
    }

    /// Sends the writer's next frame, `length` bytes long.
    fn send(&mut self, to: Name, length: usize) -> Result<Frame> {
        let frame = self.far.next_frame(&self.writer.leaf, to, length);
        let Some([to, from]) = self.writer.addresses() else {
            self.far.send(&frame)?;
            return Ok(frame);
        };
        let carrier = carrier::Carrier::Udp { from, to, class: 0 };
        let frame = Frame { to_mac: switch_mac(0), from_mac: router_mac(0), carrier, ..frame };
        self.uplink.send(&frame.bytes())?;
        Ok(frame)
    }

    fn check_copy(
        &self,
        plane: Plane,
        (way, got): &(usize, Vec<u8>),
        sent: &Frame,
        peer: &Peer,
        bits: u64,
    ) -> Result<()> {
        let Some([from, to]) = peer.addresses() else {
            let sent = Frame { carrier: carrier::Carrier::Ethernet, ..sent.clone() };
            return check_copy(got, &sent, &peer.leaf, bits).map(drop);
        };
        ensure!(*way == self.ways[usize::from(to.is_ipv6())], "{peer:?}: by s{way}");
        let at = peer.at();
        let counter = got.get(at + 12..at + 16).and_then(|bytes| bytes.first_chunk()).context("a header")?;
        let expected = Frame {
            to_mac: router_mac(*way),
            from_mac: switch_mac(*way),
            carrier: carrier::Carrier::Udp { from, to, class: 0 },
            hop_limit: sent.hop_limit - 1,
            egress_bits: bits,
            link_id: peer.leaf.peer_id(),
            link_counter: u32::from_be_bytes(*counter).into(),
            key: peer.leaf.tx_key(),
            ..sent.clone()
        };
        let expected = expected.bytes();
        // A socket's datagram has a checksum, and for IPv6 a flow label.
        let from = if plane == Plane::Kernel { 0 } else { at };
        ensure!(got[from..] == expected[from..], "to {peer:?}:\n     got {got:02x?}\nexpected {expected:02x?}");
        Ok(())
    }

    /// Waits until all peers have received this many frames; those over UDP also behind the router.
    fn wait_for(&self, peers: &[Peer], frames: u64) -> Result<()> {
        let received = |peer: &Peer| match peer.over {
            Over::Ethernet(_) => self.far.received(&peer.leaf),
            _ => self.routed.received(peer.leaf.peer_id()),
        };
        let slowest = || peers.iter().map(received).min().unwrap_or(u64::MAX);
        if slowest() >= frames {
            return Ok(());
        }
        wait_for(&format!("{frames} frames"), TIMEOUT, || Ok((slowest() >= frames).then_some(()))).with_context(|| {
            format!("got {:?}; {:?}", peers.iter().map(received).collect::<Vec<_>>(), self.switch.counted())
        })
    }

    /// Returns the packets that have arrived since the last call.
    fn take(&self) -> Taken {
        let ethernet = self.far.take().into_iter();
        let ethernet = ethernet.map(|(link, frames)| (link, frames.into_iter().map(|frame| (0, frame)).collect()));
        let mut taken = self.routed.take();
        ethernet.for_each(|(link, frames): (u32, Vec<_>)| taken.entry(link).or_default().extend(frames));
        taken
    }
}

fn switch_mac(way: usize) -> [u8; 6] {
    [2, 0, 0, 4, 0, way as u8]
}

fn router_mac(way: usize) -> [u8; 6] {
    [2, 0, 0, 5, 0, way as u8]
}

fn build_routes(switch: &Namespace, router: &Namespace, cloud: &Namespace) -> Result<()> {
    [switch, router, cloud].into_iter().try_for_each(|side| side.enable_ipv6())?;
    let end = |namespace, interface, mac| End { namespace, interface, mac };
    for (way, here, there) in [(0, "r0", "s0"), (1, "r1", "s1")] {
        veth(&end(switch, here, switch_mac(way)), &end(router, there, router_mac(way)), 1500)?;
        for state in ["off", "on"] {
            execute(router.command(Program::Ethtool)?.args(["-K", there, "gro", state]))?;
        }
    }
    veth(&end(router, "c0", [2, 0, 0, 6, 0, 1]), &end(cloud, "e0", [2, 0, 0, 6, 0, 2]), 1500)?;
    for (side, command) in [
        (switch, "addr add 10.1.0.1/24 dev r0"),
        (switch, "addr add 2001:db8:1::1/64 dev r0 nodad"),
        (switch, "addr add 10.2.0.1/24 dev r1"),
        (router, "addr add 10.1.0.254/24 dev s0"),
        (router, "addr add 2001:db8:1::254/64 dev s0 nodad"),
        (router, "addr add 10.2.0.254/24 dev s1"),
        (router, "addr add 10.9.0.254/24 dev c0"),
        (router, "addr add 2001:db8:9::254/64 dev c0 nodad"),
        (cloud, "addr add 10.9.0.9/24 dev e0"),
        (cloud, "addr add 2001:db8:9::9/64 dev e0 nodad"),
        (switch, "route add 10.9.0.0/24 via 10.1.0.254"),
        (switch, "-6 route add 2001:db8:9::/64 via 2001:db8:1::254"),
        // No traffic has resolved these neighbours yet.
        (switch, "neigh replace 10.1.0.254 lladdr 02:00:00:05:00:00 dev r0 nud reachable"),
        (switch, "neigh replace 2001:db8:1::254 lladdr 02:00:00:05:00:00 dev r0 nud reachable"),
        (switch, "neigh replace 10.2.0.254 lladdr 02:00:00:05:00:01 dev r1 nud reachable"),
        // During resolution the router would queue no more than 49 packets.
        (router, "neigh replace 10.9.0.9 lladdr 02:00:00:06:00:02 dev c0 nud permanent"),
        (router, "neigh replace 2001:db8:9::9 lladdr 02:00:00:06:00:02 dev c0 nud permanent"),
    ] {
        side.ip(&command.split(' ').collect::<Vec<_>>())?;
    }
    let _inside = router.enter()?;
    std::fs::write("/proc/sys/net/ipv4/ip_forward", "1")?;
    std::fs::write("/proc/sys/net/ipv6/conf/all/forwarding", "1")?;
    Ok(())
}

/// Packets by their link id. Each packet over UDP has the router's ingress interface.
type Taken = HashMap<u32, Vec<(usize, Vec<u8>)>>;

/// Stores all data frames over UDP that the router receives, and counts those that it forwards.
struct Routed {
    inbox: Arc<Inbox>,
    threads: Vec<JoinHandle<()>>,
}

#[derive(Default)]
struct Inbox {
    stop: AtomicBool,
    frames: Mutex<Taken>,
    passed_on: Mutex<HashMap<u32, u64>>,
}

impl Routed {
    fn start(router: &Namespace, cloud: &Namespace) -> Result<Self> {
        let inbox = Arc::new(Inbox::default());
        let mut threads = Vec::new();
        for (namespace, interface, way) in [(router, "s0", Some(0)), (router, "s1", Some(1)), (cloud, "e0", None)] {
            let socket = PacketSocket::open(namespace, interface)?;
            socket.set_receive_buffer(64 << 20)?;
            let inbox = inbox.clone();
            threads.push(std::thread::spawn(move || inbox.fill_from(&socket, way)));
        }
        Ok(Self { inbox, threads })
    }

    fn received(&self, link: u32) -> u64 {
        let came = self.inbox.frames.lock().get(&link).map_or(0, Vec::len) as u64;
        came.min(self.inbox.passed_on.lock().get(&link).copied().unwrap_or(0))
    }

    fn take(&self) -> Taken {
        self.inbox.passed_on.lock().clear();
        std::mem::take(&mut self.inbox.frames.lock())
    }
}

impl Drop for Routed {
    fn drop(&mut self) {
        self.inbox.stop.store(true, Ordering::Relaxed);
        self.threads.drain(..).for_each(|thread| drop(thread.join()));
    }
}

impl Inbox {
    fn fill_from(&self, socket: &PacketSocket, way: Option<usize>) {
        while !self.stop.load(Ordering::Relaxed) {
            let Ok(frame) = socket.receive(Duration::from_millis(50), |frame| link_in(frame).is_some()) else {
                continue;
            };
            let Some(link) = link_in(&frame) else { continue };
            match way {
                Some(way) => self.frames.lock().entry(link).or_default().push((way, frame)),
                None => *self.passed_on.lock().entry(link).or_default() += 1,
            }
        }
    }
}

/// Returns the link id of a packet that carries a data frame over UDP.
fn link_in(packet: &[u8]) -> Option<u32> {
    const DATA: u8 = 0x20;
    let at = match packet.get(12..14)? {
        [0x08, 0] if packet.get(23) == Some(&17) => 42,
        [0x86, 0xdd] if packet.get(20) == Some(&17) => 62,
        _ => return None,
    };
    let id = packet.get(at + 8..at + 12).filter(|_| packet.get(at) == Some(&DATA))?;
    Some(u32::from_be_bytes(*id.first_chunk()?))
}
