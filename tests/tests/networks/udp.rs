//! Links over UDP in the kernel: real QUIC links of three endpoints to a switch, with a router
//! between the switch and two of them.
//!
//! ```text
//!   robot:e0 ──── l0:switch:r0 ──── s0:router:c0 ──── e0:cloud
//!    Ethernet         10.1.0.1                   UDP over IPv4 from 10.2.0.9,
//!                2001:db8:1::1                   over IPv6 from 2001:db8:2::9
//! ```

use gdp_wire::hop;
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use gdp_core::identity::Identity;
use gdp_dataplane::kernel::KernelPlane;
use gdp_dataplane::pins::Pins;
use gdp_dataplane::{PinLocation, PlaneConfig, PlaneRoute, Planes, Wanted};
use gdp_link::link::{Link, LinkIds};
use gdp_link::port::{InFrame, LinkAddr, OutFrame, Port, PortConfig, RecvBatch};
use gdp_tests::Tools;
use gdp_tests::frames::carrier::internet_checksum;
use gdp_tests::netns::{End, Namespace, execute, veth};
use gdp_tests::packet::PacketSocket;
use gdp_tests::programs::{Executable as _, Program};
use gdp_tests::wait::{TIMEOUT, wait_for};
use gdp_wire::table::{PORT_ROUTED, PORT_USERSPACE, ip_words};
use gdp_wire::{Carrier, Counter, ErrorCode, FrameType, Header, LinkEntry, Name, SwitchConfig, forward, replay};
use tokio::runtime::Runtime;
use zerocopy::{FromBytes, IntoBytes};

const PORT: u16 = 31415;
const V4: &str = "10.1.0.1:31415";
const V6: &str = "[2001:db8:1::1]:31415";
const OWN_BIT: u64 = 1 << 5;

const ROBOT: usize = 0;
const INET: usize = 1;
const INET6: usize = 2;

#[test]
fn frames_cross_between_ethernet_and_both_kinds_of_udp_in_the_kernel() -> Result<()> {
    let mut site = Site::build(Wanted::Xdp)?;
    ensure!(site.links(|entry| entry.port == PORT_ROUTED) == 2, "both links over UDP are the kernel's");
    site.every_crossing(|crossed| (crossed, 0))
}

#[test]
fn frames_cross_between_ethernet_and_both_kinds_of_udp_in_userspace() -> Result<()> {
    let mut site = Site::build(Wanted::Userspace)?;
    ensure!(site.links(|entry| entry.port == PORT_USERSPACE) == 3);
    site.every_crossing(|crossed| (0, crossed))
}

/// Captures on the cable to the router, because a socket there would hide headers.
#[test]
fn what_the_kernel_sends_is_right_to_the_bit() -> Result<()> {
    let mut site = Site::build(Wanted::Xdp)?;
    let cable = PacketSocket::open(&site.router, "s0")?;
    // Lengths with one to four trailing bytes, and one above the kernel's block size for sums.
    for length in [500, 501, 502, 503, 1100] {
        let payload: Vec<u8> = (0..length).map(|i| (i * 7) as u8).collect();
        let frame = 96 + length;
        site.send(ROBOT, INET, &payload)?;
        let v4 = cable.receive(TIMEOUT, |frame| is_data(frame, 0x0800, 42))?;
        ensure!(v4.len() == 14 + 20 + 8 + frame);
        ensure!(v4[..12] == [2, 0, 0, 0, 2, 2, 2, 0, 0, 0, 2, 1], "to the router: {v4:02x?}");
        ensure!(internet_checksum(&v4[14..34]) == 0, "the header's checksum");
        ensure!(v4[14..16] == [0x45, 0] && v4[16..18] == (28 + frame as u16).to_be_bytes());
        ensure!(v4[20..22] == [0x40, 0], "not to be fragmented");
        ensure!((v4[22], v4[23]) == (64, 17));
        ensure!(v4[26..34] == [10, 1, 0, 1, 10, 2, 0, 9]);
        ensure!(v4[34..36] == PORT.to_be_bytes() && v4[38..40] == (8 + frame as u16).to_be_bytes());
        ensure!(udp_checksum_holds(&v4, 26..34), "{length} bytes: {:02x?}", &v4[34..42]);

        site.send(ROBOT, INET6, &payload)?;
        let v6 = cable.receive(TIMEOUT, |frame| is_data(frame, 0x86dd, 62))?;
        ensure!(v6.len() == 14 + 40 + 8 + frame);
        ensure!(v6[14..18] == [0x60, 0, 0, 0] && v6[18..20] == (8 + frame as u16).to_be_bytes());
        ensure!(v6[20..22] == [17, 64]);
        ensure!(v6[54..56] == PORT.to_be_bytes() && v6[58..60] == (8 + frame as u16).to_be_bytes());
        ensure!(udp_checksum_holds(&v6, 22..54), "{length} bytes: {:02x?}", &v6[54..62]);
        site.received(INET, &payload)?;
        site.received(INET6, &payload)?;
    }
    ensure!(site.count(Counter::Delivered)? == (10, 0));
    Ok(())
}

/// Long datagrams are summed in many blocks. Datagrams in several buffers have no checksum, which
/// IPv4 allows.
#[test]
fn long_datagrams_are_right_to_the_bit() -> Result<()> {
    for (mtu, frames) in [(1500, &[(1472, true)][..]), (3498, &[(3000, true)]), (9000, &[(3000, true), (5000, false)])]
    {
        let mut site = Site::with_mtu(Wanted::Xdp, mtu)?;
        let cable = PacketSocket::open(&site.router, "s0")?;
        for index in [ROBOT, INET] {
            let (mut entry, to) = site.at_switch(index);
            entry.mtu = 8000;
            site.planes.set_link(entry, to)?;
        }
        for &(frame, is_summed) in frames {
            let payload: Vec<u8> = (0..frame - Header::LEN).map(|i| (i * 7) as u8).collect();
            site.send(ROBOT, INET, &payload)?;
            let sent = cable.receive(TIMEOUT, |frame| is_data(frame, 0x0800, 42))?;
            ensure!(sent.len() == 42 + frame, "{} bytes of {frame} with an MTU of {mtu}", sent.len());
            match is_summed {
                true => ensure!(udp_checksum_holds(&sent, 26..34), "{frame} bytes: {:02x?}", &sent[34..42]),
                false => ensure!(sent[40..42] == [0, 0], "{frame} bytes: {:02x?}", &sent[34..42]),
            }
            site.received(INET, &payload)?;
        }
        ensure!(site.count(Counter::Delivered)? == (frames.len() as u64, 0), "by the kernel");
    }
    Ok(())
}

/// A switch accepts datagrams before its kernel would verify or merge them.
#[test]
fn datagrams_to_a_switch_have_no_checksum() -> Result<()> {
    let mut site = Site::build(Wanted::Xdp)?;
    let cable = PacketSocket::open(&site.router, "s0")?;
    for (to, ethertype, at) in [(INET, 0x0800, 42), (INET6, 0x86dd, 62)] {
        let (mut entry, address) = site.at_switch(to);
        entry.carrier.flags &= !Carrier::CHECKSUM;
        site.planes.set_link(entry, address)?;
        site.send(ROBOT, to, b"unchecked")?;
        let sent = cable.receive(TIMEOUT, |frame| is_data(frame, ethertype, at))?;
        ensure!(sent[at - 2..at] == [0, 0], "{:02x?}", &sent[at - 8..at]);
        site.received(to, b"unchecked")?;
    }
    ensure!(site.count(Counter::Delivered)? == (2, 0));
    Ok(())
}

/// Verifies the checksum with the pseudo headers of RFC 768 and RFC 8200. `addresses`: their range
/// in the packet, directly before UDP.
fn udp_checksum_holds(packet: &[u8], addresses: std::ops::Range<usize>) -> bool {
    let udp = addresses.end;
    let length = (packet.len() - udp) as u32;
    let summed = [&packet[addresses], &length.to_be_bytes(), &[0, 0, 0, 17], &packet[udp..]].concat();
    packet[udp + 6..udp + 8] != [0, 0] && internet_checksum(&summed) == 0
}

#[test]
fn a_peer_that_refuses_datagrams_without_checksums_is_sent_to_from_userspace() -> Result<()> {
    let mut site = Site::build(Wanted::Xdp)?;
    let cable = PacketSocket::open(&site.router, "s0")?;
    let (mut entry, to) = site.at_switch(INET6);
    entry.carrier.flags = 0;
    site.planes.set_link(entry, to)?;
    site.send(ROBOT, INET6, b"checked")?;
    let sent = cable.receive(TIMEOUT, |frame| is_data(frame, 0x86dd, 62))?;
    ensure!(udp_checksum_holds(&sent, 22..54), "{:02x?}", &sent[54..62]);
    site.received(INET6, b"checked")?;
    // A frame is counted after it is sent, so it may arrive earlier.
    wait_for("the counts", TIMEOUT, || {
        let counted = (site.count(Counter::Slow)?, site.count(Counter::Delivered)?);
        Ok((counted == ((1, 0), (0, 1))).then_some(()))
    })
}

#[test]
fn an_unresolved_neighbour_takes_the_slow_path_until_it_is_resolved() -> Result<()> {
    let mut site = Site::build(Wanted::Xdp)?;
    let mut sent = 0;
    for (to, family) in [(INET, "-4"), (INET6, "-6")] {
        // QUIC may resolve the neighbour again at any time.
        let slow = site.count(Counter::Slow)?.0;
        wait_for("a frame that finds no neighbour", TIMEOUT, || {
            site.switch.ip(&[family, "neigh", "flush", "dev", "r0"])?;
            site.send(ROBOT, to, b"unresolved")?;
            site.received(to, b"unresolved")?;
            sent += 1;
            Ok((site.count(Counter::Slow)?.0 > slow).then_some(()))
        })?;
        let before = site.count(Counter::Slow)?.0;
        site.send(ROBOT, to, b"resolved")?;
        site.received(to, b"resolved")?;
        sent += 1;
        ensure!(site.count(Counter::Slow)?.0 == before, "the next one is the kernel's again");
    }
    // A frame is counted after it is sent, so it may arrive earlier.
    let slow = site.count(Counter::Slow)?.0;
    wait_for(&format!("{slow} of {sent} frames to be counted in userspace"), TIMEOUT, || {
        Ok((site.count(Counter::Delivered)? == (sent - slow, slow)).then_some(()))
    })
    .with_context(|| format!("{:?}", site.planes.counters()))
}

/// The kernel drops the frames, each with its drop reason; the daemon does not receive them.
#[test]
fn an_attacker_on_the_path_gets_nothing_through() -> Result<()> {
    let mut site = Site::build(Wanted::Xdp)?;
    let attacker = site.in_cloud(|| Ok(UdpSocket::bind("10.2.0.9:0")?))?;
    let honest = site.next_frame(INET, ROBOT, b"honest");
    site.send_frame(INET, &honest, b"honest")?;
    site.received(ROBOT, b"honest")?;

    let entry = site.ends[INET].link.entry(PORT_USERSPACE);
    let restamped = |site: &mut Site, change: &dyn Fn(&mut Header)| {
        let mut header = site.next_frame(INET, ROBOT, b"honest");
        change(&mut header);
        hop::stamp(&mut header, &entry, site.ends[INET].sent);
        header
    };
    let mut forged = site.next_frame(INET, ROBOT, b"honest");
    forged.reserved = 1;
    let mut moved = site.next_frame(INET, ROBOT, b"honest");
    moved.set_link_id(site.ends[ROBOT].at_switch.local_id());
    let mut unknown = moved;
    unknown.set_link_id(moved.link_id() ^ 0x200);
    let robot = site.ends[ROBOT].name;
    let spoofed = restamped(&mut site, &|header| header.source = robot);
    let unpermitted = restamped(&mut site, &|header| header.destination = FORBIDDEN);
    let mut cut = site.next_frame(INET, ROBOT, b"honest");
    cut.version_type = 0x2f;
    for (frame, reason) in [
        (forged, Counter::BadTag),
        (honest, Counter::Replayed),
        (moved, Counter::BadTag),
        (unknown, Counter::NoLink),
        (spoofed, Counter::Source),
        (unpermitted, Counter::NotPermitted),
        (cut, Counter::Unknown),
    ] {
        let before = site.count(reason)?.0;
        attacker.send_to(&[frame.as_bytes(), b"honest"].concat(), V4)?;
        let counted =
            wait_for(&format!("{reason:?}"), TIMEOUT, || Ok(Some(site.count(reason)?).filter(|c| c.0 > before)))?;
        ensure!(counted == (before + 1, 0), "{reason:?}: {counted:?}");
    }
    ensure!(site.count(Counter::Delivered)? == (1, 0), "nothing but the honest one");
    Ok(())
}

/// A peer's address changes during use, as when a NAT loses its binding.
#[test]
fn a_link_follows_its_peer_through_a_rebinding() -> Result<()> {
    let mut site = Site::build(Wanted::Xdp)?;
    let nat = Nat::start(&site)?;
    site.dial(INET, "10.2.0.9:0", "10.2.0.254:31415")?;
    site.send(INET, ROBOT, b"before")?;
    site.received(ROBOT, b"before")?;
    let (_, before) = site.at_switch(INET);

    nat.rebind.store(true, Ordering::Relaxed);
    site.send(INET, ROBOT, b"from elsewhere")?;
    site.received(ROBOT, b"from elsewhere")?;
    ensure!(site.count(Counter::Delivered)? == (2, 0), "taken from wherever it comes");

    let (entry, after) = wait_for("QUIC to validate the new path", TIMEOUT, || {
        Ok(Some(site.at_switch(INET)).filter(|(_, to)| *to != before))
    })?;
    ensure!(entry.carrier.peer_ip == site.ends[INET].at_switch.carrier().peer_ip);
    site.planes.set_link(entry, after)?;
    site.send(ROBOT, INET, b"to elsewhere")?;
    site.received(INET, b"to elsewhere")?;
    ensure!(site.count(Counter::Delivered)? == (3, 0), "and sent there by the kernel");
    Ok(())
}

#[test]
fn what_is_not_ours_passes_untouched() -> Result<()> {
    let site = Site::build(Wanted::Xdp)?;
    let (other, listener) = {
        let _inside = site.switch.enter()?;
        (UdpSocket::bind("10.1.0.1:9999")?, TcpListener::bind("10.1.0.1:31415")?)
    };
    other.set_read_timeout(Some(TIMEOUT))?;
    let mut buffer = vec![0; 8192];
    let from = site.in_cloud(|| Ok(UdpSocket::bind("10.2.0.9:0")?))?;
    // One datagram whose first byte equals GDP's; and one so large that it is fragmented.
    for datagram in [&[0x20; 100][..], &[0x20; 5000]] {
        from.send_to(datagram, "10.1.0.1:9999")?;
        let length = other.recv(&mut buffer)?;
        ensure!(&buffer[..length] == datagram);
    }
    site.in_cloud(|| Ok(TcpStream::connect_timeout(&V4.parse()?, TIMEOUT)?))?;
    listener.accept()?;
    ensure!(site.count(Counter::Unknown)? == (0, 0) && site.count(Counter::Foreign)?.0 >= 5);
    Ok(())
}

#[test]
fn what_does_not_fit_the_path_is_told() -> Result<()> {
    for (to, largest) in [(INET, 1472), (INET6, 1452)] {
        let mut site = Site::build(Wanted::Xdp)?;
        // QUIC probes the MTU in steps, and ends within a few bytes of the path's.
        let (entry, address) = wait_for("QUIC to know the path", TIMEOUT, || {
            Ok(Some(site.at_switch(to)).filter(|(entry, _)| entry.mtu > largest - 25))
        })?;
        ensure!(entry.mtu <= largest, "{entry:?}");
        site.planes.set_link(entry, address)?;
        let fits = vec![1; entry.mtu as usize - 96];
        site.send(ROBOT, to, &fits)?;
        site.received(to, &fits)?;
        site.send(ROBOT, to, &[fits, vec![2]].concat())?;
        let (header, _) = site.next_received(ROBOT)?;
        ensure!(header.version_type == FrameType::Error.first_byte() && header.egress_set == ErrorCode::TooBig as u8);
        ensure!(header.complaint() == (entry.mtu, site.ends[ROBOT].sent as u32), "{header:?}");
        ensure!(site.count(Counter::Delivered)? == (1, 0) && site.count(Counter::TooBig)? == (1, 0));
    }
    Ok(())
}

/// The socket is bound to all addresses, including later ones.
#[test]
fn an_address_that_comes_later_is_served_as_well() -> Result<()> {
    let mut site = Site::build(Wanted::Xdp)?;
    site.switch.ip(&["addr", "add", "10.1.0.2/24", "dev", "r0"])?;
    {
        let _inside = site.switch.enter()?;
        site.planes.refresh()?;
    }
    site.dial(INET, "10.2.0.9:0", "10.1.0.2:31415")?;
    site.send(INET, ROBOT, b"there")?;
    site.received(ROBOT, b"there")?;
    site.send(ROBOT, INET, b"and back")?;
    site.received(INET, b"and back")?;
    ensure!(site.count(Counter::Delivered)? == (2, 0));
    Ok(())
}

/// A link's entry contains its carrier, so a daemon finds the previous daemon's link addresses in
/// the kernel.
#[test]
fn links_over_udp_are_taken_over_from_an_earlier_daemon() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let namespace = Namespace::create("switch")?;
    let _inside = namespace.enter()?;
    let object = Tools::beside_this_test()?.ebpf_object()?;
    let carrier = |peer: &str| -> Result<Carrier> {
        let peer: SocketAddr = peer.parse()?;
        let (kind, peer_ip) = ip_words(peer.ip());
        Ok(Carrier { kind, peer_ip, peer_port: peer.port().to_be(), local_ip: peer_ip, ..Carrier::default() })
    };
    let link = |id, carrier, port| LinkEntry { id, role: 1, mtu: 1400, port, carrier, ..LinkEntry::default() };
    let links = [
        link(0x1401, carrier("192.0.2.1:2000")?, PORT_ROUTED),
        link(0x1402, carrier("[2001:db8::2]:3000")?, PORT_USERSPACE),
        link(0x1403, carrier("[fe80::3]:4000")?, PORT_USERSPACE),
    ];
    let pins = PinLocation { bpffs: folder.path().into(), switch: FORBIDDEN, replaces: false };
    {
        let pins = Pins::open(&pins)?;
        let mut before = KernelPlane::load_pinned(&object, 1024, Some(pins))?;
        before.set_config(SwitchConfig { own_bit: 1, ethertype: 0x88b5, host_pair: 0 })?;
        links.iter().try_for_each(|link| before.set_link(link))?;
    }
    let config = PlaneConfig { ebpf_object: Some(object), fib_capacity: 1024, pins: Some(pins), ..Default::default() };
    let mut planes = Planes::open(config)?;
    let left = planes.left().map(|left| left.links.clone()).unwrap_or_default();
    planes.detach_all();
    execute(Program::Umount.command().arg("--lazy").arg(folder.path()))?;
    let mut left: Vec<_> = left.into_iter().map(|(entry, to)| (entry, to.to_string())).collect();
    left.sort_by_key(|(entry, _)| entry.id);
    // The entry does not contain the interface of a link-local address.
    ensure!(
        left == [(links[0].into(), "udp:192.0.2.1:2000".into()), (links[1].into(), "udp:[2001:db8::2]:3000".into())],
        "{left:?}"
    );
    Ok(())
}

/// A name without publisher or reader.
const FORBIDDEN: Name = Name::from_bytes([0xf0; 32]);

/// An endpoint, its link, and the switch's end of that link.
struct Endpoint {
    // Fields drop in this order.
    link: Link,
    at_switch: Link,
    port: Port,
    identity: Identity,
    name: Name,
    sent: u64,
    window: Box<replay::Window>,
}

struct Site {
    // Fields drop in this order.
    ends: Vec<Endpoint>,
    planes: Planes,
    /// Ethernet, then UDP.
    ports: [Port; 2],
    runtime: Runtime,
    robot: Namespace,
    switch: Namespace,
    router: Namespace,
    cloud: Namespace,
}

impl Site {
    fn build(wanted: Wanted) -> Result<Self> {
        Self::with_mtu(wanted, 1500)
    }

    fn with_mtu(wanted: Wanted, mtu: u32) -> Result<Self> {
        let [robot, switch, router, cloud] = ["robot", "switch", "router", "cloud"].map(Namespace::create);
        let (robot, switch, router, cloud) = (robot?, switch?, router?, cloud?);
        [&switch, &router, &cloud].into_iter().try_for_each(|side| side.enable_ipv6())?;
        let end = |namespace, interface, mac| End { namespace, interface, mac };
        veth(&end(&robot, "e0", [2, 0, 0, 0, 1, 1]), &end(&switch, "l0", [2, 0, 0, 0, 1, 2]), mtu)?;
        veth(&end(&switch, "r0", [2, 0, 0, 0, 2, 1]), &end(&router, "s0", [2, 0, 0, 0, 2, 2]), mtu)?;
        veth(&end(&router, "c0", [2, 0, 0, 0, 3, 1]), &end(&cloud, "e0", [2, 0, 0, 0, 3, 2]), mtu)?;
        for (side, interface) in [(&robot, "e0"), (&router, "s0")] {
            for state in ["off", "on"] {
                execute(side.command(Program::Ethtool)?.args(["-K", interface, "gro", state]))?;
            }
        }
        for (side, command) in [
            (&switch, "addr add 10.1.0.1/24 dev r0"),
            (&switch, "addr add 2001:db8:1::1/64 dev r0"),
            (&router, "addr add 10.1.0.254/24 dev s0"),
            (&router, "addr add 2001:db8:1::254/64 dev s0"),
            (&router, "addr add 10.2.0.254/24 dev c0"),
            (&router, "addr add 2001:db8:2::254/64 dev c0"),
            (&cloud, "addr add 10.2.0.9/24 dev e0"),
            (&cloud, "addr add 2001:db8:2::9/64 dev e0"),
            (&switch, "route add 10.2.0.0/24 via 10.1.0.254"),
            (&switch, "-6 route add 2001:db8:2::/64 via 2001:db8:1::254"),
            (&cloud, "route add default via 10.2.0.254"),
            (&cloud, "-6 route add default via 2001:db8:2::254"),
        ] {
            side.ip(&command.split(' ').collect::<Vec<_>>())?;
        }
        {
            let _inside = router.enter()?;
            std::fs::write("/proc/sys/net/ipv4/ip_forward", "1")?;
            std::fs::write("/proc/sys/net/ipv6/conf/all/forwarding", "1")?;
        }
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
        let (planes, ports) = {
            let (_inside, _runtime) = (switch.enter()?, runtime.enter());
            let config = PortConfig::switch(Identity::generate("switch")?, LinkIds::new());
            let ports = [Port::ethernet("l0", &config)?, Port::udp(SocketAddr::new([0u16; 8].into(), PORT), &config)?];
            let ebpf_object = Some(Tools::beside_this_test()?.ebpf_object()?);
            let mut planes = Planes::open(PlaneConfig { wanted, ebpf_object, ..Default::default() })?;
            planes.attach(ports[0].interface().context("an interface")?, ports[0].data())?;
            let reports = planes.attach_udp(ports[1].data(), ports[1].udp_addr().context("an address")?, None)?;
            let native =
                |report: &gdp_dataplane::InterfacePlane| report.kind == "xdp-native" && report.interface == "r0";
            ensure!(wanted == Wanted::Userspace || matches!(&reports[..], [report] if native(report)), "{reports:?}");
            planes.set_own_bit(OWN_BIT)?;
            (planes, ports)
        };
        let mut site = Self { ends: Vec::new(), planes, ports, runtime, robot, switch, router, cloud };
        site.dial(ROBOT, "", "")?;
        site.dial(INET, "10.2.0.9:0", V4)?;
        site.dial(INET6, "[2001:db8:2::9]:0", V6)?;
        let nobody = PlaneRoute { egress_bits: OWN_BIT, writers: vec![0x7fff_0001], ..PlaneRoute::default() };
        site.planes.set_route(FORBIDDEN, &nobody)?;
        Ok(site)
    }

    /// Connects an endpoint, or reconnects it. All other endpoints may send to it.
    fn dial(&mut self, index: usize, bind: &str, to: &str) -> Result<()> {
        let namespace = if index == ROBOT { &self.robot } else { &self.cloud };
        let identity = match self.ends.get(index) {
            Some(end) => end.identity.clone(),
            None => Identity::generate("proxy")?,
        };
        let config = PortConfig::endpoint(identity.clone());
        let port = {
            let (_inside, _runtime) = (namespace.enter()?, self.runtime.enter());
            if index == ROBOT { Port::ethernet("e0", &config)? } else { Port::udp(bind.parse()?, &config)? }
        };
        let listening = &self.ports[usize::from(index != ROBOT)];
        let (link, at_switch) = self.runtime.block_on(async {
            let to = match index {
                ROBOT => port.discover(None, TIMEOUT).await.first().context("an answer")?.0,
                _ => LinkAddr::udp(to.parse()?),
            };
            let (link, accepted) = tokio::join!(port.dial(to, None), listening.accept());
            anyhow::Ok((link?, accepted.context("a link")??))
        })?;
        let name = identity.name();
        let end = Endpoint { link, at_switch, port, identity, name, sent: 0, window: Box::new(replay::empty()) };
        if index < self.ends.len() {
            self.planes.remove_link(self.ends[index].at_switch.local_id())?;
            self.ends[index] = end;
        } else {
            self.ends.push(end);
        }
        let (entry, to) = self.at_switch(index);
        self.planes.set_link(entry, to)?;
        let links: Vec<u32> = self.ends.iter().map(|end| end.at_switch.local_id()).collect();
        for (reader, end) in self.ends.iter().enumerate() {
            let mut writers = links.clone();
            writers.retain(|link| *link != links[reader]);
            writers.sort_unstable();
            let route =
                PlaneRoute { egress_bits: OWN_BIT, readers: vec![links[reader]], writers, ..PlaneRoute::default() };
            self.planes.set_route(topic(end.name), &route)?;
        }
        Ok(())
    }

    /// Returns a link's present state at the switch.
    fn at_switch(&self, index: usize) -> (LinkEntry, LinkAddr) {
        let link = &self.ends[index].at_switch;
        (link.entry(PORT_USERSPACE), link.addr())
    }

    /// Returns the number of links in the planes that match.
    fn links(&self, wanted: impl Fn(&LinkEntry) -> bool) -> usize {
        self.planes.links().iter().filter(|entry| wanted(entry)).count()
    }

    /// Sends frames between all pairs. `planes`: each plane's expected deliveries, by their sum.
    fn every_crossing(&mut self, planes: impl Fn(u64) -> (u64, u64)) -> Result<()> {
        let mut crossed = 0;
        for from in [ROBOT, INET, INET6] {
            for to in [ROBOT, INET, INET6].into_iter().filter(|to| *to != from) {
                for length in [0, 1, 500, 1100] {
                    let payload = vec![length as u8; length];
                    self.send(from, to, &payload)
                        .and_then(|()| self.received(to, &payload))
                        .with_context(|| format!("{length} bytes from {from} to {to}: {:?}", self.planes.counters()))?;
                    crossed += 1;
                }
            }
        }
        let expected = planes(crossed);
        wait_for(&format!("{expected:?} to be delivered"), TIMEOUT, || {
            Ok((self.count(Counter::Delivered)? == expected).then_some(()))
        })
        .with_context(|| format!("{:?}", self.planes.counters()))
    }

    /// Returns the header of an endpoint's next frame to another.
    fn next_frame(&mut self, from: usize, to: usize, payload: &[u8]) -> Header {
        let destination = topic(self.ends[to].name);
        let from = &mut self.ends[from];
        from.sent += 1;
        let mut header = Header::data(destination, from.name, payload.len() as u16);
        hop::stamp(&mut header, &from.link.entry(PORT_USERSPACE), from.sent);
        header
    }

    fn send(&mut self, from: usize, to: usize, payload: &[u8]) -> Result<()> {
        let header = self.next_frame(from, to, payload);
        self.send_frame(from, &header, payload)
    }

    fn send_frame(&self, from: usize, header: &Header, payload: &[u8]) -> Result<()> {
        let from = &self.ends[from];
        let frame = OutFrame { to: from.link.addr(), head: header.as_bytes(), body: payload };
        ensure!(from.port.data().send_batch([frame]).sent == 1, "not sent");
        Ok(())
    }

    /// Checks that the endpoint's next data frame is this one.
    fn received(&self, at: usize, payload: &[u8]) -> Result<()> {
        let (header, body) = self.next_received(at)?;
        ensure!(header.version_type == FrameType::Data.first_byte(), "{header:?}");
        ensure!(header.destination == topic(self.ends[at].name) && body == payload, "{header:?}: {} bytes", body.len());
        Ok(())
    }

    fn next_received(&self, at: usize) -> Result<(Header, Vec<u8>)> {
        let end = &self.ends[at];
        let (data, entry) = (end.port.data(), end.link.entry(PORT_USERSPACE));
        let mut batch = RecvBatch::new(8192);
        wait_for("a frame", TIMEOUT, || {
            data.wait_readable(Duration::from_millis(10))?;
            let received = data.try_recv_batch(&mut batch)?;
            let Some(InFrame { bytes: frame, .. }) = batch.frames().next() else { return Ok(None) };
            let (header, body) =
                Header::read_from_prefix(frame).map_err(|_| anyhow::anyhow!("{} bytes", frame.len()))?;
            let accepted = forward::accept(&header, frame.len(), &entry, &*end.window);
            ensure!(accepted.is_ok(), "{accepted:?}: {header:?}");
            ensure!(received == 1, "more than one frame");
            Ok(Some((header, body.to_vec())))
        })
    }

    /// Returns the counts of the kernel and of the userspace plane.
    fn count(&self, wanted: Counter) -> Result<(u64, u64)> {
        let counted = self.planes.counters()?.into_iter().find(|(counter, ..)| *counter == wanted);
        counted.map(|(_, kernel, userspace)| (kernel, userspace)).context("all counters")
    }

    fn in_cloud<T>(&self, act: impl FnOnce() -> Result<T>) -> Result<T> {
        let _inside = self.cloud.enter()?;
        act()
    }
}

/// Returns the name that only this endpoint reads.
fn topic(reader: Name) -> Name {
    Name::from_bytes(reader.to_bytes().map(|byte| !byte))
}

/// Returns whether an Ethernet frame carries a data frame at this offset.
fn is_data(frame: &[u8], ethertype: u16, at: usize) -> bool {
    frame[12..14] == ethertype.to_be_bytes() && frame.get(at) == Some(&FrameType::Data.first_byte())
}

/// Relays datagrams between the cloud and the switch, from another port once `rebind` is set.
struct Nat {
    rebind: Arc<AtomicBool>,
    stop: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Nat {
    fn start(site: &Site) -> Result<Self> {
        let _inside = site.router.enter()?;
        let inner = UdpSocket::bind("10.2.0.254:31415")?;
        let outer = [UdpSocket::bind("10.1.0.254:2001")?, UdpSocket::bind("10.1.0.254:2002")?];
        let (rebind, stop) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
        outer.iter().chain([&inner]).try_for_each(|socket| socket.set_nonblocking(true))?;
        let (rebound, stopped) = (rebind.clone(), stop.clone());
        let thread = std::thread::spawn(move || {
            let (mut buffer, mut client) = ([0; 2048], None);
            while !stopped.load(Ordering::Relaxed) {
                let outer = &outer[usize::from(rebound.load(Ordering::Relaxed))];
                let mut idle = true;
                while let Ok((length, from)) = inner.recv_from(&mut buffer) {
                    client = Some(from);
                    idle = outer.send_to(&buffer[..length], V4).is_err();
                }
                while let (Ok(length), Some(client)) = (outer.recv(&mut buffer), client) {
                    idle = inner.send_to(&buffer[..length], client).is_err();
                }
                if idle {
                    std::thread::park_timeout(Duration::from_micros(200));
                }
            }
        });
        Ok(Self { rebind, stop, thread: Some(thread) })
    }
}

impl Drop for Nat {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.take().map(std::thread::JoinHandle::join);
    }
}
