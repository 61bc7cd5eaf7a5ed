//! The fixtures' switch in both data planes, and the results for frames there. The kernel runs
//! under `BPF_PROG_TEST_RUN` and sends nothing. It looks up next hops of links over UDP in a
//! network namespace's routing table.
pub mod dpdk;

use anyhow::{Context, Result, bail, ensure};
use gdp_dataplane::group_slots::Member;
use gdp_dataplane::kernel::{Buffers, KernelPlane, XdpAction};
use gdp_dataplane::link_memory::LinkMemory;
use gdp_dataplane::tables::UserTables;
use gdp_dataplane::udp::Routing;
use gdp_dataplane::userspace::{Outcome, copies, handle};
use gdp_link::port::Interface;
use gdp_tests::Tools;
use gdp_tests::frames::fixtures::{Fate, Switch, Verdict};
use gdp_tests::netns::{End, Entered, Namespace, veth};
use gdp_wire::header::FIRST_QUIC_BYTE;
use gdp_wire::{Counter, Header, LocalAddress, Vlan};
use zerocopy::IntoBytes;

/// The network of the fixtures' switch: one interface, with a gateway of each address family behind
/// it.
pub struct Site {
    // Fields drop in this order.
    _inside: Entered,
    switch: Namespace,
    _gateway: Namespace,
}

impl Site {
    /// Builds the network. The calling thread is inside until the guard is dropped.
    pub fn build() -> Result<Self> {
        let (switch, gateway) = (Namespace::create("switch")?, Namespace::create("gateway")?);
        switch.enable_ipv6()?;
        veth(
            &End { namespace: &switch, interface: "e0", mac: [2, 0, 0, 0, 0xee, 1] },
            &End { namespace: &gateway, interface: "e0", mac: [2, 0, 0, 0, 0xee, 4] },
            9000,
        )?;
        let ip = |arguments: &str| switch.ip(&arguments.split(' ').collect::<Vec<_>>());
        ip("addr add 10.0.0.1/24 dev e0")?;
        ip("addr add 2001:db8::1/64 dev e0 nodad")?;
        for (family, gateway, mac) in
            [("-4", "10.0.0.4", "02:00:00:00:ee:04"), ("-6", "2001:db8::6", "02:00:00:00:ee:06")]
        {
            ip(&format!("neigh add {gateway} lladdr {mac} dev e0 nud permanent"))?;
            let far = if family == "-4" {
                ["192.0.2.0/24", "198.51.100.0/24"]
            } else {
                ["2001:db8:9::/64", "2001:db8:a::/64"]
            };
            for far in far {
                ip(&format!("{family} route add {far} via {gateway}"))?;
            }
        }
        let inside = switch.enter()?;
        let routing = Routing::enable();
        ensure!(routing == Routing { v4: Ok(()), v6: Ok(()) }, "{routing:?}");
        Ok(Self { _inside: inside, switch, _gateway: gateway })
    }

    /// Loads the fixtures' switch into the kernel.
    pub fn kernel_plane(&self, switch: &Switch) -> Result<KernelPlane> {
        let mut plane = KernelPlane::load(&Tools::beside_this_test()?.ebpf_object()?, 1024)?;
        let e0 = Interface::find("e0").with_context(|| self.switch.name().to_owned())?.index;
        ensure!(e0 < PORTS, "e0 is {e0}");
        fill(&mut plane, switch)?;
        Ok(plane)
    }
}

/// Ports below this number lead to `lo`: a test run sends nothing.
const PORTS: u32 = 6;

pub fn fill(plane: &mut KernelPlane, switch: &Switch) -> Result<()> {
    // A test run also uses this interface as ingress.
    const LOOPBACK: u32 = 1;
    (0..PORTS).try_for_each(|port| plane.set_port(port, LOOPBACK))?;
    let addresses = switch.own_addresses().into_iter().map(|own| LocalAddress::new(own.ip(), own.port()));
    plane.set_addresses(&addresses.collect())?;
    let vlans = switch.vlans().into_iter().map(|id| Vlan { ifindex: LOOPBACK, id: id.into() });
    plane.set_vlans(&vlans.collect())?;
    plane.set_config(switch.config())?;
    switch.links().try_for_each(|link| plane.set_link(&link))?;
    for (name, entry, permitted) in switch.routes() {
        permitted.iter().try_for_each(|permit| plane.permit(permit))?;
        plane.set_route(&name, entry)?;
    }
    plane.set_next_hops(&switch.next_hops())?;
    for (group, links, served) in switch.kernel_groups() {
        let members: Vec<_> = links.iter().map(|link| Member { link: link.id, interface: LOOPBACK }).collect();
        plane.set_group(group, &members, served)?;
    }
    Ok(())
}

pub fn user_tables(switch: &Switch) -> (UserTables, LinkMemory) {
    let link_memory = LinkMemory::new();
    (user_tables_with(switch, link_memory.clone()), link_memory)
}

pub fn user_tables_with(switch: &Switch, link_memory: LinkMemory) -> UserTables {
    let mut tables = UserTables::new(link_memory, 1024).expect("memory");
    for link in switch.links() {
        // Distinct addresses only identify the links.
        let to = gdp_link::port::LinkAddr::Ethernet { ifindex: link.port, mac: [0; 6] };
        tables.set_link(link, to);
    }
    switch.groups().for_each(|(group, readers)| tables.set_group(group, readers));
    for (name, entry, permitted) in switch.routes() {
        tables.set_route(name, entry, &permitted).expect("room");
    }
    tables.set_next_hops(&switch.next_hops());
    tables.set_own_bit(switch.config().own_bit);
    tables
}

/// Returns the kernel's result for a frame: the action, and exactly one counter.
pub fn run(plane: &mut KernelPlane, buffers: Buffers, frame: &[u8]) -> Result<Fate> {
    let before = plane.counters()?;
    let fate = run_uncounted(plane, buffers, frame)?;
    Ok(match counted(before, plane.counters()?)? {
        // A frame to copy does not count as a frame yet; the kernel would make the copies at their
        // egress.
        Counter::Replicated => Fate::copied(vec![]),
        counter => Fate { counter, ..fate },
    })
}

/// Returns the kernel's result for a frame without its counter. `Slow`, `Forwarded` and
/// `RedirectFailed` stand for any frame that passes, is sent or is dropped. Reading the counters
/// takes far longer than processing the frame.
pub fn run_uncounted(plane: &mut KernelPlane, buffers: Buffers, frame: &[u8]) -> Result<Fate> {
    let (action, out) = plane.programs.test_run(buffers, frame)?;
    Ok(match action {
        XdpAction::Redirect => Fate::sent(out, Counter::Forwarded),
        XdpAction::Pass => {
            ensure!(out == frame, "a frame that passes was changed");
            Fate::new(Verdict::Pass, Counter::Slow)
        }
        XdpAction::Drop => Fate::new(Verdict::Drop, Counter::RedirectFailed),
        XdpAction::Other(action) => bail!("action {action}"),
    })
}

/// Returns the one counter that has increased, by one.
pub fn counted(before: [u64; Counter::COUNT], after: [u64; Counter::COUNT]) -> Result<Counter> {
    let differences = Counter::ALL.iter().zip(before.into_iter().zip(after));
    let risen: Vec<_> = differences.filter(|(_, (before, after))| before != after).collect();
    match risen[..] {
        [(counter, (before, after))] if after == before + 1 => Ok(*counter),
        _ => bail!("counted {risen:?}"),
    }
}

/// Returns the userspace plane's result for a frame. The frame has the Ethernet header with which
/// it arrived or leaves.
pub fn run_userspace(tables: &UserTables, switch: &Switch, frame: &[u8]) -> Fate {
    let place = switch.find(frame).expect("a frame of ours");
    let mut gdp = frame[place.at..place.at + place.length].to_vec();
    let carried = |link: u32, parts: &[&[u8]]| {
        let link = switch.link(link).expect("a link of the switch");
        link.carry(switch.ethertype, &parts.concat())
    };
    let mut reader = tables.reader();
    let tables = reader.enter();
    match handle(&mut gdp, place.class & 3 == 3, &tables) {
        Outcome::Send { link, length, counter, .. } => Fate::sent(carried(link, &[&gdp[..length]]), counter),
        Outcome::Copies { ingress, group } => {
            let (mut sent, mut dropped) = (Vec::new(), Vec::new());
            copies(&gdp, (ingress, group), &tables, |copy| sent.push(copy), |counter| dropped.push((None, counter)));
            let sent = sent.iter().map(|copy| {
                let payload = &gdp[Header::LEN..copy.header.frame_len()];
                (Some(carried(copy.link, &[copy.header.as_bytes(), payload])), copy.counter)
            });
            Fate::copied(sent.chain(dropped).collect())
        }
        Outcome::Notice { .. } => Fate::new(Verdict::Pass, Counter::Notice),
        Outcome::Control => Fate::new(Verdict::Pass, Counter::Control),
        Outcome::Drop(counter) => Fate::new(Verdict::Drop, counter),
    }
}

/// Returns whether the userspace plane's sockets do not receive a packet: it belongs to another
/// protocol, or to QUIC.
pub fn is_for_no_data_socket(switch: &Switch, packet: &[u8]) -> bool {
    match switch.find(packet) {
        Some(place) => place.over_udp && place.length > 0 && packet[place.at] >= FIRST_QUIC_BYTE,
        None => true,
    }
}
