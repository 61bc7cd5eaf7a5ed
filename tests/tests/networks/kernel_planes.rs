//! The planes on real interfaces: the choice of plane, and frames that cross the switch in either.
//!
//! ```text
//!   left:e0 ──── l0:switch:r0 ──── e0:right
//! ```

use std::cell::Cell;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result, ensure};
use gdp_core::identity::Identity;
use gdp_dataplane::{PlaneConfig, PlaneError, PlaneRoute, Planes, Wanted};
use gdp_link::link::LinkIds;
use gdp_link::port::{Interface, LinkAddr, Port, PortConfig};
use gdp_tests::Tools;
use gdp_tests::frames::Frame;
use gdp_tests::frames::carrier::Carrier as Carried;
use gdp_tests::netns::{End, Namespace, execute, veth};
use gdp_tests::packet::PacketSocket;
use gdp_tests::programs::Program;
use gdp_tests::wait::{TIMEOUT, wait_for};
use gdp_wire::{Carrier, Counter, LinkEntry, LinkRole, Name};

const LEFT_MAC: [u8; 6] = [2, 0, 0, 0, 1, 1];
const RIGHT_MAC: [u8; 6] = [2, 0, 0, 0, 2, 1];
const L0_MAC: [u8; 6] = [2, 0, 0, 0, 1, 2];
const R0_MAC: [u8; 6] = [2, 0, 0, 0, 2, 2];

const TOPIC: Name = Name::from_bytes([0xd0; 32]);
const OWN_BIT: u64 = 1 << 5;

#[test]
fn frames_cross_a_switch_in_native_xdp() -> Result<()> {
    let site = Site::build(1500)?;
    let switch = site.switch(Wanted::Auto)?;
    for report in switch.planes.report() {
        ensure!((report.kind, report.reason.as_str()) == ("xdp-native", "the driver supports it"), "{report:?}");
    }
    let crossed = site.send_through(1400)?;
    ensure!(crossed.len() == 14 + 1400);
    ensure!(switch.counted(Counter::Delivered)? == (1, 0), "{:?}", switch.planes.counters());
    Ok(())
}

#[test]
fn jumbo_frames_cross_in_several_buffers() -> Result<()> {
    let site = Site::build(9000)?;
    let switch = site.switch(Wanted::Xdp)?;
    let crossed = site.send_through(8900)?;
    ensure!(crossed.len() == 14 + 8900);
    ensure!(switch.counted(Counter::Delivered)? == (1, 0));
    Ok(())
}

#[test]
fn frames_cross_a_switch_in_userspace() -> Result<()> {
    let site = Site::build(1500)?;
    let switch = site.switch(Wanted::Userspace)?;
    for report in switch.planes.report() {
        ensure!(report.kind == "userspace" && report.reason.contains("turns it off"), "{report:?}");
    }
    let crossed = site.send_through(1400)?;
    ensure!(crossed.len() == 14 + 1400);
    ensure!(switch.counted(Counter::Delivered)? == (0, 1));
    ensure!(switch.planes.arrivals(left_link().id)?[Counter::Delivered as usize] == 1);
    Ok(())
}

/// A veth drops redirected frames while its peer has neither GRO nor a program; the planes must
/// detect this.
#[test]
fn an_interface_that_takes_no_redirects_is_served_from_userspace() -> Result<()> {
    let site = Site::build(1500)?;
    gro(&site.right, "off")?;
    let mut switch = site.switch(Wanted::Auto)?;
    let report = switch.planes.report();
    ensure!(report[1].reason.contains("gro on"), "{report:?}");
    site.send_through(200)?;
    ensure!(switch.counted(Counter::Slow)? == (1, 0) && switch.counted(Counter::Delivered)? == (0, 1));

    gro(&site.right, "on")?;
    site.refresh(&mut switch)?;
    site.send_through(200)?;
    ensure!(switch.counted(Counter::Delivered)? == (1, 1), "from then on in the kernel");
    Ok(())
}

/// Both planes send on the link. Its counter must not repeat, because the neighbour's replay window
/// would drop frames.
#[test]
fn the_planes_share_the_counter_of_a_link() -> Result<()> {
    let site = Site::build(1500)?;
    gro(&site.right, "off")?;
    let mut switch = site.switch(Wanted::Auto)?;
    let link_counter = |frame: Vec<u8>| u32::from_be_bytes([frame[26], frame[27], frame[28], frame[29]]);
    let in_userspace = link_counter(site.send_through(200)?);
    gro(&site.right, "on")?;
    site.refresh(&mut switch)?;
    let in_kernel = link_counter(site.send_through(200)?);
    ensure!((in_userspace, in_kernel) == (1, 2), "{in_userspace} then {in_kernel}");
    Ok(())
}

/// A frame that one plane accepted is a replay to the other.
#[test]
fn the_planes_share_the_window_of_a_link() -> Result<()> {
    let site = Site::build(1500)?;
    gro(&site.right, "off")?;
    let mut switch = site.switch(Wanted::Auto)?;
    let (in_userspace, in_kernel) = (site.next_frame(200), site.next_frame(200));
    let counted = |switch: &Switch, counter, count: (u64, u64)| -> Result<()> {
        wait_for(&format!("{counter:?} to be {count:?}"), TIMEOUT, || {
            Ok((switch.count(counter)? == count).then_some(()))
        })
    };
    site.send(&in_userspace)?;
    counted(&switch, Counter::Delivered, (0, 1))?;
    site.send(&in_userspace)?;
    counted(&switch, Counter::Replayed, (1, 0))?;

    gro(&site.right, "on")?;
    site.refresh(&mut switch)?;
    site.send(&in_kernel)?;
    counted(&switch, Counter::Delivered, (1, 1))?;
    [&in_kernel, &in_userspace].into_iter().try_for_each(|frame| site.send(frame))?;
    counted(&switch, Counter::Replayed, (3, 0))?;

    gro(&site.right, "off")?;
    site.refresh(&mut switch)?;
    [&in_kernel, &in_userspace].into_iter().try_for_each(|frame| site.send(frame))?;
    counted(&switch, Counter::Replayed, (5, 0))?;
    counted(&switch, Counter::Delivered, (1, 1))?;

    // The link stays the same when its reach changes.
    let reach = LinkEntry { reach: 1 << 9, ..left_link() };
    let at = switch.address_of_left()?;
    switch.planes.set_link(reach, at)?;
    site.send(&in_kernel)?;
    counted(&switch, Counter::Replayed, (6, 0))?;
    Ok(())
}

#[test]
fn permission_comes_and_goes_in_the_kernel() -> Result<()> {
    let site = Site::build(1500)?;
    let mut switch = site.switch(Wanted::Xdp)?;
    let [first, second] = [left_link(), LinkEntry { id: 0x1003, rx_keys: [[9, 10]; 2], ..left_link() }];
    let at = switch.address_of_left()?;
    switch.planes.set_link(second, at)?;
    let route = |writers: &[u32]| PlaneRoute {
        egress_bits: OWN_BIT,
        readers: vec![right_link().id],
        writers: writers.to_vec(),
        ..PlaneRoute::default()
    };
    let (mut delivered, mut refused) = (0, 0);
    for (route, may) in [
        (route(&[first.id]), [true, false]),
        (route(&[first.id, second.id]), [true, true]),
        (route(&[second.id, first.id]), [true, true]),
        (route(&[second.id]), [false, true]),
        (route(&[0x1004, first.id, second.id]), [true, true]),
        (route(&[0x1004]), [false, false]),
        (route(&[]), [false, false]),
    ] {
        switch.planes.set_route(TOPIC, &route)?;
        let mut writers = switch.planes.writers(&TOPIC);
        writers.retain(|link| *link != 0x1004);
        ensure!(writers.len() == may.iter().filter(|may| **may).count(), "{writers:x?}");
        for (link, may) in [first, second].into_iter().zip(may) {
            site.send(&Frame { link_id: link.id, key: link.rx_keys[0], ..site.next_frame(200) })?;
            *(if may { &mut delivered } else { &mut refused }) += 1;
            wait_for(&format!("{delivered} delivered, {refused} refused at {route:?}"), TIMEOUT, || {
                let counts = (switch.count(Counter::Delivered)?, switch.count(Counter::NotPermitted)?);
                Ok((counts == ((delivered, 0), (refused, 0))).then_some(()))
            })?;
        }
    }
    switch.planes.remove_route(&TOPIC)?;
    switch.planes.set_route(TOPIC, &route(&[0x1004, 0x1005]))?;
    site.send(&Frame { link_id: first.id, key: first.rx_keys[0], ..site.next_frame(200) })?;
    wait_for("a permit to go with its name", TIMEOUT, || {
        Ok((switch.count(Counter::NotPermitted)? == (refused + 1, 0)).then_some(()))
    })
}

#[test]
fn who_may_come_from_abroad_comes_and_goes_in_the_kernel() -> Result<()> {
    let site = Site::build(1500)?;
    let mut switch = site.switch(Wanted::Xdp)?;
    let border = LinkEntry { role: LinkRole::Border as u32, ..left_link() };
    let at = switch.address_of_left()?;
    switch.planes.set_link(border, at)?;
    let (mut delivered, mut refused) = (0, 0);
    for sources in [vec![], vec![border.id], vec![0x1004, border.id], vec![0x1004], vec![border.id], vec![]] {
        let may = sources.contains(&border.id);
        let route = PlaneRoute { sources, ..PlaneRoute::default() };
        match route.is_idle() {
            true => switch.planes.remove_route(&border.peer)?,
            false => switch.planes.set_route(border.peer, &route)?,
        }
        site.send(&site.next_frame(200))?;
        *(if may { &mut delivered } else { &mut refused }) += 1;
        wait_for(&format!("{delivered} delivered, {refused} refused at {route:?}"), TIMEOUT, || {
            let counts = (switch.count(Counter::Delivered)?, switch.count(Counter::Source)?);
            Ok((counts == ((delivered, 0), (refused, 0))).then_some(()))
        })?;
    }
    Ok(())
}

/// The FIB begins small, and larger ones replace it. One frame is in flight at a time, so every
/// loss is detected.
#[test]
fn no_frame_is_lost_while_the_fib_grows() -> Result<()> {
    const NAMES: u32 = 40_000;
    let site = Site::build(1500)?;
    let mut switch = site.switch(Wanted::Xdp)?;
    let (from, to) = (PacketSocket::open(&site.left, "e0")?, PacketSocket::open(&site.right, "e0")?);
    let (template, over) = (site.next_frame(200), AtomicBool::new(false));
    let (sent, grown) = std::thread::scope(|scope| {
        let traffic = scope.spawn(|| -> Result<u64> {
            let mut sent = 0;
            while sent < 1000 || !over.load(Ordering::Relaxed) {
                sent += 1;
                from.send(&Frame { link_counter: sent, ..template.clone() }.bytes())?;
                to.receive(TIMEOUT, gdp_tests::packet::is_gdp_data)
                    .with_context(|| format!("frame {sent} was lost"))?;
            }
            Ok(sent)
        });
        let grown = (0..NAMES).try_for_each(|i| {
            let name = Name::from_bytes(std::array::from_fn(|at| i.to_be_bytes()[at % 4]));
            switch.planes.set_route(name, &PlaneRoute { egress_bits: 1 << 9, ..PlaneRoute::default() })
        });
        over.store(true, Ordering::Relaxed);
        (traffic.join().expect("no panic"), grown)
    });
    grown?;
    ensure!(switch.planes.routes()?.len() == NAMES as usize + 1);
    ensure!(switch.count(Counter::Delivered)? == (sent?, 0), "{:?}", switch.planes.counters());
    Ok(())
}

/// A VLAN is served on the interface below it. Here another interface stands in for the VLAN's own.
#[test]
fn a_vlan_is_served_on_the_interface_below_it() -> Result<()> {
    const TAG: Carried = Carried::Vlan(5);
    let site = Site::build(1500)?;
    site.switch.ip(&["link", "add", "v0", "type", "veth", "peer", "name", "v1"])?;
    let mut switch = site.switch(Wanted::Xdp)?;
    let _inside = site.switch.enter()?;
    let lower = Interface::find("l0")?;
    switch.planes.detach(lower.index);
    let vlan = gdp_link::port::Vlan { lower: lower.name, lower_index: lower.index, id: 5 };
    let interface = Interface { vlan: Some(vlan), ..Interface::find("v0")? };
    let port = {
        let _runtime = switch.runtime.enter();
        Port::ethernet("v0", &PortConfig::switch(Identity::generate("switch")?, LinkIds::new()))?
    };
    let report = switch.planes.attach(&interface, port.data())?;
    ensure!((report.interface.as_str(), report.kind) == ("v0", "xdp-native"), "{report:?}");
    let on_vlan = LinkEntry { carrier: Carrier { vlan: 5, ..left_link().carrier }, ..left_link() };
    switch.planes.set_link(on_vlan, LinkAddr::Ethernet { ifindex: interface.index, mac: LEFT_MAC })?;

    let to = PacketSocket::open(&site.right, "e0")?;
    site.send(&Frame { carrier: TAG, ..site.next_frame(200) })?;
    to.receive(TIMEOUT, gdp_tests::packet::is_gdp_data)?;
    ensure!(switch.counted(Counter::Delivered)? == (1, 0));

    // An echo returns with a tag. The kernel removes the tag before a packet socket sees the frame,
    // and counts the frame there.
    let from = PacketSocket::open(&site.left, "e0")?;
    let echo = Frame { carrier: TAG, version_type: 0x24, hop_limit: 1, payload: vec![], ..site.next_frame(96) };
    site.send(&echo)?;
    let answer = from.receive(TIMEOUT, |frame| frame.len() == 110 && frame[14] == 0x24)?;
    ensure!(answer[..12] == [LEFT_MAC, L0_MAC].concat() && switch.count(Counter::Echoed)? == (1, 0), "{answer:02x?}");

    site.send(&Frame { carrier: Carried::Vlan(6), ..site.next_frame(200) })?;
    wait_for("another VLAN's frame to pass", TIMEOUT, || Ok((switch.count(Counter::Foreign)?.0 > 0).then_some(())))?;
    switch.planes.detach(interface.index);
    ensure!(!site.switch.ip(&["-o", "link", "show", "l0"])?.contains("xdp"), "nothing needs it any more");
    Ok(())
}

/// A bridge has no native XDP and accepts no redirected frames. Frames redirected by generic XDP
/// are ordinary packets.
#[test]
fn without_native_xdp_generic_is_next() -> Result<()> {
    let site = Site::build(1500)?;
    for (bridge, port, mac) in [("b0", "l0", L0_MAC), ("b1", "r0", R0_MAC)] {
        let mac = mac.map(|byte| format!("{byte:02x}")).join(":");
        site.switch.ip(&[
            "link",
            "add",
            bridge,
            "address",
            &mac,
            "type",
            "bridge",
            "stp_state",
            "0",
            "forward_delay",
            "0",
        ])?;
        site.switch.ip(&["link", "set", port, "master", bridge])?;
        site.switch.ip(&["link", "set", bridge, "up"])?;
    }
    let switch = site.switch_on(Wanted::Xdp, ["b0", "b1"])?;
    for report in switch.planes.report() {
        ensure!(report.kind == "xdp-generic", "{report:?}");
        ensure!(report.reason == "no native XDP: the driver has none", "{report:?}");
    }
    site.send_through(1400)?;
    ensure!(switch.counted(Counter::Delivered)? == (1, 0), "{:?}", switch.planes.counters());
    Ok(())
}

#[test]
fn a_foreign_program_is_left_alone() -> Result<()> {
    let site = Site::build(1500)?;
    let theirs = site.switch(Wanted::Auto)?;
    let ours = site.switch(Wanted::Auto)?;
    for report in ours.planes.report() {
        ensure!(report.kind == "userspace" && report.reason.contains("another XDP program"), "{report:?}");
    }
    ensure!(theirs.planes.report().iter().all(|report| report.kind == "xdp-native"));

    let refused = site.switch(Wanted::Xdp).err().context("XDP was asked for and cannot be had")?;
    let refused = refused.downcast::<PlaneError>()?;
    ensure!(matches!(&refused, PlaneError::NoXdp { interface, .. } if interface == "l0"), "{refused}");
    Ok(())
}

#[test]
fn dropping_the_planes_detaches() -> Result<()> {
    let site = Site::build(1500)?;
    let shown = || site.switch.ip(&["-o", "link", "show", "l0"]);
    let switch = site.switch(Wanted::Xdp)?;
    ensure!(shown()?.contains("xdp"), "{}", shown()?);
    drop(switch);
    ensure!(!shown()?.contains("xdp"), "{}", shown()?);
    Ok(())
}

#[test]
fn a_missing_object_is_no_obstacle_unless_xdp_was_asked_for() -> Result<()> {
    let config = |wanted| PlaneConfig { wanted, ebpf_object: Some("/nonexistent".into()), ..Default::default() };
    Planes::open(config(Wanted::Auto))?;
    let error = Planes::open(config(Wanted::Xdp)).err().context("an error")?.to_string();
    ensure!(error.contains("/nonexistent") && error.contains("cargo xtask build"), "{error}");
    Ok(())
}

struct Site {
    left: Namespace,
    switch: Namespace,
    right: Namespace,
    /// Frames sent from the left end.
    sent: Cell<u64>,
}

impl Site {
    fn build(mtu: u32) -> Result<Self> {
        let [left, switch, right] = ["left", "switch", "right"].map(Namespace::create);
        let site = Self { left: left?, switch: switch?, right: right?, sent: Cell::new(0) };
        let end = |namespace, interface, mac| End { namespace, interface, mac };
        veth(&end(&site.left, "e0", LEFT_MAC), &end(&site.switch, "l0", L0_MAC), mtu)?;
        veth(&end(&site.switch, "r0", R0_MAC), &end(&site.right, "e0", RIGHT_MAC), mtu)?;
        // The kernel notices a GRO change for the other end only while this end is up.
        for side in [&site.left, &site.right] {
            gro(side, "off")?;
            gro(side, "on")?;
        }
        Ok(site)
    }

    /// Starts a switch on both interfaces, with a link to each side and a route from left to right.
    fn switch(&self, wanted: Wanted) -> Result<Switch> {
        self.switch_on(wanted, ["l0", "r0"])
    }

    fn switch_on(&self, wanted: Wanted, interfaces: [&str; 2]) -> Result<Switch> {
        let _inside = self.switch.enter()?;
        let object = Tools::beside_this_test()?.ebpf_object()?;
        let planes = Planes::open(PlaneConfig { wanted, ebpf_object: Some(object), ..Default::default() })?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let mut switch = Switch { planes, ports: Vec::new(), runtime };
        for interface in interfaces {
            switch.attach_here(interface)?;
        }
        let ifindex = |i: usize| switch.ports[i].interface().map(|interface| interface.index).context("an interface");
        let (left, right) = (ifindex(0)?, ifindex(1)?);
        switch.planes.set_own_bit(OWN_BIT)?;
        switch.planes.set_link(left_link(), LinkAddr::Ethernet { ifindex: left, mac: LEFT_MAC })?;
        switch.planes.set_link(right_link(), LinkAddr::Ethernet { ifindex: right, mac: RIGHT_MAC })?;
        let (readers, writers) = (vec![right_link().id], vec![left_link().id]);
        switch
            .planes
            .set_route(TOPIC, &PlaneRoute { egress_bits: OWN_BIT, readers, writers, ..PlaneRoute::default() })?;
        ensure!(matches!(switch.planes.routes()?[..], [(TOPIC, _)]));
        Ok(switch)
    }

    /// Sends a frame of `length` bytes from the left end. The frame on the right must be what the
    /// switch should send.
    fn send_through(&self, length: usize) -> Result<Vec<u8>> {
        let to = PacketSocket::open(&self.right, "e0")?;
        let frame = self.next_frame(length);
        self.send(&frame)?;
        let crossed = to.receive(TIMEOUT, gdp_tests::packet::is_gdp_data)?;
        let link_counter = u32::from_be_bytes([crossed[26], crossed[27], crossed[28], crossed[29]]).into();
        let expected = Frame {
            to_mac: RIGHT_MAC,
            from_mac: R0_MAC,
            hop_limit: 63,
            link_id: right_link().peer_id,
            link_counter,
            key: right_link().tx_keys[0],
            ..frame
        };
        ensure!(crossed == expected.bytes(), "{crossed:02x?}");
        Ok(crossed)
    }

    /// Returns the next frame of the left end, `length` bytes long.
    fn next_frame(&self, length: usize) -> Frame {
        self.sent.update(|sent| sent + 1);
        Frame {
            to_mac: L0_MAC,
            from_mac: LEFT_MAC,
            link_id: left_link().id,
            link_counter: self.sent.get(),
            key: left_link().rx_keys[0],
            destination: TOPIC.to_bytes(),
            payload: vec![0x5a; length - 96],
            ..Frame::default()
        }
    }

    fn refresh(&self, switch: &mut Switch) -> Result<()> {
        let _inside = self.switch.enter()?;
        Ok(switch.planes.refresh()?)
    }

    fn send(&self, frame: &Frame) -> Result<()> {
        PacketSocket::open(&self.left, "e0")?.send(&frame.bytes())
    }
}

fn gro(side: &Namespace, state: &str) -> Result<()> {
    execute(side.command(Program::Ethtool)?.args(["-K", "e0", "gro", state])).map(drop)
}

struct Switch {
    planes: Planes,
    ports: Vec<Port>,
    runtime: tokio::runtime::Runtime,
}

impl Switch {
    fn attach_here(&mut self, interface: &str) -> Result<()> {
        let _runtime = self.runtime.enter();
        let identity = Identity::generate("switch")?;
        let port = Port::ethernet(interface, &PortConfig::switch(identity, LinkIds::new()))?;
        let found = port.interface().context("an interface")?.clone();
        self.planes.attach(&found, port.data())?;
        self.ports.push(port);
        Ok(())
    }

    fn address_of_left(&self) -> Result<LinkAddr> {
        let ifindex = self.ports[0].interface().context("an interface")?.index;
        Ok(LinkAddr::Ethernet { ifindex, mac: LEFT_MAC })
    }

    /// Returns the counts of the kernel and of the userspace plane.
    fn count(&self, wanted: Counter) -> Result<(u64, u64)> {
        let counted = self.planes.counters()?.into_iter().find(|(counter, ..)| *counter == wanted);
        counted.map(|(_, kernel, userspace)| (kernel, userspace)).context("all counters")
    }

    /// Returns the counts of the kernel and of the userspace plane, once there are any.
    fn counted(&self, wanted: Counter) -> Result<(u64, u64)> {
        wait_for("a frame to be counted", TIMEOUT, || Ok(Some(self.count(wanted)?).filter(|count| *count != (0, 0))))
    }
}

fn left_link() -> LinkEntry {
    LinkEntry {
        id: 0x1001,
        peer_id: 0x2001,
        mtu: 9000,
        rx_keys: [[1, 2]; 2],
        tx_keys: [[3, 4]; 2],
        ..endpoint(LEFT_MAC, L0_MAC)
    }
}

fn right_link() -> LinkEntry {
    LinkEntry {
        id: 0x1002,
        peer_id: 0x2002,
        mtu: 9000,
        rx_keys: [[5, 6]; 2],
        tx_keys: [[7, 8]; 2],
        ..endpoint(RIGHT_MAC, R0_MAC)
    }
}

fn endpoint(peer_mac: [u8; 6], local_mac: [u8; 6]) -> LinkEntry {
    let carrier = Carrier::ethernet(peer_mac, local_mac);
    LinkEntry { role: LinkRole::Endpoint as u32, carrier, ..LinkEntry::default() }
}
