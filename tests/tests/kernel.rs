//! The XDP switch under `BPF_PROG_TEST_RUN`: the real program in the real kernel, one frame at a time. Nothing is sent; but it asks
//! the routing table of a network namespace where links over UDP lead.

use std::process::Command;
use std::sync::Barrier;

use anyhow::{Context, Result, ensure};
use gdp::port::Interface;
use gdp_ctl::plane::kernel::{self, Action, KernelPlane, LoadError, UpdateError};
use gdp_ctl::plane::link_memory::LinkMemory;
use gdp_ctl::plane::pins::{self, Pins};
use gdp_ctl::plane::udp::Routing;
use gdp_ctl::plane::userspace::{Outcome, UserTables, copies, handle};
use gdp_tests::Tools;
use gdp_tests::frames::Frame;
use gdp_tests::frames::fixtures::{self, Bytes, CopyOut, Expected, Fixtures, Switch, Verdict};
use gdp_tests::netns::{End, Entered, Namespace, execute, veth};
use gdp_wire::header::FIRST_QUIC_BYTE;
use gdp_wire::{Counter, FibEntry, Header, LocalAddress, Name, Vlan, replay};
use zerocopy::IntoBytes;

#[test]
fn every_fixture_through_the_kernel() -> Result<()> {
    let Fixtures { switch, cases, .. } = fixtures::read();
    let site = Site::build()?;
    let mut plane = site.kernel_plane(&switch)?;
    for case in &cases {
        reset(plane.link_memory(), &switch);
        let got = run(&mut plane, &case.frame.bytes()).with_context(|| case.name.clone())?;
        // A plane without groups leaves what is to be copied to the userspace plane.
        let expected = if case.kernel.verdict == Verdict::Copy { &pass("slow") } else { &case.kernel };
        ensure!(got == *expected, "{}:\n     got {got:?}\nexpected {expected:?}", case.name);
    }
    Ok(())
}

#[test]
fn every_fixture_through_the_userspace_plane() -> Result<()> {
    let Fixtures { switch, cases, .. } = fixtures::read();
    for case in &cases {
        let expected = case.userspace.as_ref().unwrap_or(&case.kernel);
        if is_for_no_data_socket(&switch, &case.frame.bytes()) {
            continue;
        }
        let (tables, link_memory) = user_tables(&switch);
        reset(&link_memory, &switch);
        let got = run_userspace(&tables, &switch, &case.frame.bytes());
        ensure!(got == *expected, "{}:\n     got {got:?}\nexpected {expected:?}", case.name);
    }
    Ok(())
}

/// Frames that are nearly right in many ways must meet the same fate in both planes, also when they come again.
#[test]
fn random_frames_get_the_same_verdict_from_both_planes() -> Result<()> {
    let Fixtures { switch, .. } = fixtures::read();
    let site = Site::build()?;
    let mut kernel = site.kernel_plane(&switch)?;
    let (tables, link_memory) = user_tables(&switch);
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    let mut seen = [0u32; Counter::COUNT];
    for round in 0..40_000 {
        let frame = random_frame(&mut random, &switch);
        reset(kernel.link_memory(), &switch);
        reset(&link_memory, &switch);
        let got = run(&mut kernel, &frame)?;
        let counter = Counter::ALL.iter().position(|c| c.as_str() == got.counter).context("a counter")?;
        seen[counter] += 1;
        if is_for_no_data_socket(&switch, &frame) {
            let counter = Counter::ALL[counter];
            ensure!(matches!(counter, Counter::Foreign | Counter::Control), "round {round}: {got:?}");
            continue;
        }
        let userspace = run_userspace(&tables, &switch, &frame);
        let same = match Counter::ALL[counter] {
            // The kernel leaves these to the userspace plane, or would redirect to an interface that is not there.
            Counter::Slow => userspace.verdict != Verdict::Drop,
            Counter::RedirectFailed => userspace.verdict == Verdict::Send,
            // A neighbour that the kernel cannot send to is not told why.
            _ if got.verdict == Verdict::Drop && link_of(&frame, &switch).is_some_and(|link| link.port.is_none()) => {
                got.counter == userspace.counter
            }
            _ => got == userspace,
        };
        let shown = fixtures::hex(&frame[..frame.len().min(128)]);
        ensure!(same, "round {round}: kernel {got:?}\nuserspace {userspace:?}\nframe {shown}");
        if Counter::ALL[counter] == Counter::Slow {
            continue;
        }
        let again = (run(&mut kernel, &frame)?, run_userspace(&tables, &switch, &frame));
        ensure!(again.0.counter == again.1.counter, "round {round}, again: {again:?}\nframe {shown}");
        let replayed = again.0.counter == Counter::Replayed.as_str();
        ensure!(
            replayed || !matches!(userspace.verdict, Verdict::Send | Verdict::Copy),
            "round {round}, again: {again:?}\nframe {shown}"
        );
    }
    for (counter, seen) in Counter::ALL.iter().zip(seen) {
        if matches!(counter, Counter::Notice | Counter::Replicated | Counter::RedirectLost) {
            // The kernel leaves the first two to the userspace plane; what a redirect loses is known only after it.
            continue;
        }
        ensure!(seen > 20, "the random frames reached {counter:?} only {seen} times");
    }
    Ok(())
}

/// Frames of one link may come to the kernel and to the userspace plane at once. Both are given the same frames, in opposite
/// order; each must be sent on by one of them.
#[test]
fn frames_that_come_to_both_planes_at_once_are_taken_once() -> Result<()> {
    const ROUNDS: usize = 1000;
    const FRAMES: usize = 64;
    let Fixtures { switch, .. } = fixtures::read();
    let site = Site::build()?;
    let mut kernel = site.kernel_plane(&switch)?;
    let (link, route) = (&switch.links[0], &switch.routes[0]);
    ensure!(route.writers.contains(&link.id), "{} may not send to {}", link.label, route.label);
    let tables = user_tables_with(&switch, kernel.link_memory().clone());
    kernel.link_memory().begin(link.id);
    let frames: Vec<Vec<u8>> = (1..=ROUNDS * FRAMES)
        .map(|count| Frame {
            link_id: link.id,
            key: fixtures::key(&link.rx_keys[0]),
            link_counter: count as u64,
            destination: fixtures::array(&route.name),
            source: fixtures::array(&link.peer),
            ..Frame::default()
        })
        .map(|frame| frame.bytes())
        .collect();

    let together = Barrier::new(2);
    let (in_kernel, in_userspace) = std::thread::scope(|scope| {
        let in_userspace = scope.spawn(|| {
            let mut sent = Vec::new();
            for round in frames.chunks(FRAMES) {
                together.wait();
                sent.extend(round.iter().rev().map(|frame| {
                    let outcome = handle(&mut frame[14..].to_vec(), &tables);
                    (matches!(outcome, Outcome::Send { .. }), outcome)
                }));
                let start = sent.len() - round.len();
                sent[start..].reverse();
            }
            sent
        });
        let mut in_kernel = Vec::new();
        for round in frames.chunks(FRAMES) {
            together.wait();
            // An error must not leave the other thread waiting.
            in_kernel.extend(round.iter().map(|frame| kernel.test_run(frame).map(|(action, _)| action)));
        }
        (in_kernel, in_userspace.join().expect("no panic"))
    });

    let mut won = [0, 0];
    for (frame, (kernel, (by_userspace, outcome))) in in_kernel.into_iter().zip(in_userspace).enumerate() {
        let by_kernel = kernel? == Action::Redirect;
        ensure!(by_kernel != by_userspace, "frame {frame}: sent by the kernel: {by_kernel}; userspace: {outcome:?}");
        ensure!(by_userspace || outcome == Outcome::Drop(Counter::Replayed), "frame {frame}: {outcome:?}");
        won[usize::from(by_userspace)] += 1;
    }
    ensure!(won.iter().all(|won| *won > 100), "the planes hardly met: {won:?}");
    Ok(())
}

#[test]
fn the_map_is_the_fib() -> Result<()> {
    let Fixtures { switch, .. } = fixtures::read();
    let site = Site::build()?;
    let mut plane = site.kernel_plane(&switch)?;
    let sorted = |mut routes: Vec<(Name, FibEntry)>| {
        routes.sort_by_key(|(name, _)| *name);
        routes
    };
    ensure!(
        sorted(plane.routes().collect()) == sorted(switch.routes().map(|(name, entry, _)| (name, entry)).collect())
    );
    let (name, ..) = switch.routes().next().context("a route")?;
    ensure!(plane.remove_route(&name) && !plane.remove_route(&name));
    ensure!(plane.routes().all(|(present, _)| present != name));
    Ok(())
}

#[test]
fn a_full_fib_refuses_and_forgets_nothing() -> Result<()> {
    let mut plane = KernelPlane::load(&Tools::beside_this_test()?.ebpf_object()?, 100)?;
    let name = |i: u8| Name::from_bytes([i; 32]);
    let entry = FibEntry { egress_bits: 1, ..FibEntry::default() };
    for i in 0..100 {
        plane.set_route(&name(i), entry)?;
    }
    let refused = plane.set_route(&name(100), entry);
    ensure!(matches!(refused, Err(UpdateError::FibFull { capacity: 100 })), "{refused:?}");
    plane.set_route(&name(7), FibEntry { egress_bits: 2, ..entry })?;
    ensure!(plane.routes().count() == 100);
    Ok(())
}

/// A daemon that dies leaves its table, which may be about to replace a smaller one.
#[test]
fn a_successor_takes_over_a_fib_that_has_grown() -> Result<()> {
    const NAMES: u32 = 5000;
    let Fixtures { switch, cases, .. } = fixtures::read();
    let case = cases.iter().find(|case| case.kernel.verdict == Verdict::Send).context("a frame that is sent")?;
    let bpffs = Bpffs(tempfile::tempdir()?);
    let open = || -> Result<KernelPlane> {
        let pins = Pins::open(bpffs.0.path(), &Name::default())?;
        Ok(KernelPlane::load_pinned(&Tools::beside_this_test()?.ebpf_object()?, 3 * NAMES, Some(pins))?)
    };
    let forwards = |plane: &mut KernelPlane| -> Result<()> {
        reset(plane.link_memory(), &switch);
        let got = run(plane, &case.frame.bytes())?;
        ensure!(got == case.kernel, "{got:?}");
        Ok(())
    };
    let name = |i: u32| Name::from_bytes(std::array::from_fn(|at| i.to_be_bytes()[at % 4]));
    let sorted = |plane: &KernelPlane| {
        let mut routes: Vec<_> = plane.routes().collect();
        routes.sort_by_key(|(name, _)| *name);
        routes
    };

    let mut plane = open()?;
    ensure!(plane.adopted()?.is_none());
    fill(&mut plane, &switch)?;
    for i in 0..NAMES {
        plane.set_route(&name(i), FibEntry { egress_bits: i.into(), ..FibEntry::default() })?;
    }
    forwards(&mut plane)?;
    let left = sorted(&plane);
    drop(plane);
    let found = pins::find(bpffs.0.path())?.pop().context("something is pinned")?;
    ensure!(kernel::pinned_stats(&found.folder)?.names == left.len());

    let mut plane = open()?;
    ensure!(plane.adopted()?.context("something was left")?.routes.len() == left.len() && sorted(&plane) == left);
    forwards(&mut plane)?;
    drop(plane);
    // As if the daemon had died when the larger table was ready, and before it was in the place of the other.
    std::fs::rename(found.folder.join("FIB_TABLE"), found.folder.join("FIB_TABLE_NEW"))?;

    let mut plane = open()?;
    ensure!(sorted(&plane) == left);
    (NAMES..2 * NAMES).try_for_each(|i| plane.set_route(&name(i), FibEntry::default()))?;
    forwards(&mut plane)?;
    ensure!(plane.routes().count() == left.len() + NAMES as usize, "it can grow further");
    ensure!(kernel::pinned_stats(&found.folder)?.names == plane.routes().count());
    plane.unpin()?;
    ensure!(!found.folder.exists());
    Ok(())
}

#[test]
fn what_cannot_be_loaded_is_named() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("gdp-ebpf");
    let error = |result: Result<KernelPlane, LoadError>| result.err().map(|e| e.to_string()).unwrap_or_default();
    ensure!(error(KernelPlane::load(&file, 10)).contains("gdp-ebpf"));
    std::fs::write(&file, b"not an object")?;
    ensure!(error(KernelPlane::load(&file, 10)).contains("parsing"), "{}", error(KernelPlane::load(&file, 10)));
    Ok(())
}

/// The network of the fixtures' switch: one interface, with a gateway of each family behind it.
struct Site {
    // Order is the order of the end.
    _inside: Entered,
    switch: Namespace,
    _gateway: Namespace,
}

impl Site {
    /// The calling thread is inside while it lives.
    fn build() -> Result<Self> {
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

    /// The fixtures' switch in the kernel.
    fn kernel_plane(&self, switch: &Switch) -> Result<KernelPlane> {
        let mut plane = KernelPlane::load(&Tools::beside_this_test()?.ebpf_object()?, 1024)?;
        let e0 = Interface::find("e0").with_context(|| self.switch.name().to_owned())?.index;
        ensure!(e0 < PORTS, "e0 is {e0}");
        fill(&mut plane, switch)?;
        Ok(plane)
    }
}

/// Ports below this lead to `lo`: in a test run nothing is sent.
const PORTS: u32 = 6;

fn fill(plane: &mut KernelPlane, switch: &Switch) -> Result<()> {
    // A test run comes in by it as well.
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
    Ok(())
}

/// A folder in which [`Pins`] mounts a BPF file system.
struct Bpffs(tempfile::TempDir);

impl Drop for Bpffs {
    fn drop(&mut self) {
        let _ = execute(Command::new("umount").arg("--lazy").arg(self.0.path()));
    }
}

fn user_tables(switch: &Switch) -> (UserTables, LinkMemory) {
    let link_memory = LinkMemory::new();
    (user_tables_with(switch, link_memory.clone()), link_memory)
}

fn user_tables_with(switch: &Switch, link_memory: LinkMemory) -> UserTables {
    let mut tables = UserTables::new(link_memory);
    for link in switch.links() {
        // Only to be told apart.
        let to = gdp::port::LinkAddr::Ethernet { ifindex: link.port, mac: [0; 6] };
        tables.set_link(link, to);
    }
    for (name, entry, permitted) in switch.routes() {
        tables.set_route(name, entry, &permitted);
    }
    switch.groups().for_each(|(group, readers)| tables.set_group(group, readers));
    tables.set_next_hops(&switch.next_hops());
    tables.set_own_bit(switch.config().own_bit);
    tables
}

fn reset(memory: &LinkMemory, switch: &Switch) {
    for link in &switch.links {
        memory.begin(link.id);
        memory.set_count(link.id, link.tx_counter);
        link.taken.iter().for_each(|count| assert!(replay::take(memory.window(link.id), *count)));
    }
}

/// What the kernel does with a frame: the action, and exactly one counter.
fn run(plane: &mut KernelPlane, frame: &[u8]) -> Result<Expected> {
    let before = plane.counters()?;
    let (action, out) = plane.test_run(frame)?;
    let after = plane.counters()?;
    let mut counted = Vec::new();
    for (counter, (before, after)) in Counter::ALL.iter().zip(before.into_iter().zip(after)) {
        counted.extend((before..after).map(|_| counter.as_str()));
    }
    let [counter] = counted[..] else { anyhow::bail!("counted {counted:?}") };
    let verdict = match action {
        Action::Redirect => Verdict::Send,
        Action::Pass => Verdict::Pass,
        Action::Drop => Verdict::Drop,
        Action::Other(action) => anyhow::bail!("action {action}"),
    };
    ensure!(verdict != Verdict::Pass || out == frame, "a frame that passes was changed");
    let sent = (verdict == Verdict::Send).then(|| Bytes::new(&out));
    Ok(Expected { verdict, counter: counter.into(), frame: sent, copies: vec![] })
}

/// What the userspace plane does with a frame, dressed in the Ethernet header it came with or leaves with.
fn run_userspace(tables: &UserTables, switch: &Switch, frame: &[u8]) -> Expected {
    let place = switch.find(frame).expect("a frame of ours");
    let mut gdp = frame[place.at..place.at + place.length].to_vec();
    let outcome = |verdict, counter: Counter| Expected { verdict, ..pass(counter.as_str()) };
    let carried = |link: u32, parts: &[&[u8]]| {
        let link = switch.link(link).expect("a link of the switch");
        Some(Bytes::new(&link.carry(switch.ethertype, &parts.concat())))
    };
    match handle(&mut gdp, tables) {
        Outcome::Send { link, length, counter, .. } => {
            Expected { frame: carried(link, &[&gdp[..length]]), ..outcome(Verdict::Send, counter) }
        }
        Outcome::Copies { ingress, group } => {
            let (mut sent, mut dropped) = (Vec::new(), Vec::new());
            copies(&gdp, (ingress, group), tables, |copy| sent.push(copy), |counter| dropped.push(counter));
            let sent = sent.iter().map(|copy| CopyOut {
                frame: carried(copy.link, &[copy.header.as_bytes(), &gdp[Header::LEN..copy.header.frame_len()]]),
                counter: copy.counter.as_str().into(),
            });
            let dropped = dropped.iter().map(|counter| CopyOut { frame: None, counter: counter.as_str().into() });
            let mut copies: Vec<_> = sent.chain(dropped).collect();
            copies.sort();
            Expected { copies, ..outcome(Verdict::Copy, Counter::Replicated) }
        }
        Outcome::Notice { .. } => outcome(Verdict::Pass, Counter::Notice),
        Outcome::Control => outcome(Verdict::Pass, Counter::Control),
        Outcome::Drop(counter) => outcome(Verdict::Drop, counter),
    }
}

fn pass(counter: &str) -> Expected {
    Expected { verdict: Verdict::Pass, counter: counter.into(), frame: None, copies: vec![] }
}

/// Whether the sockets of the userspace plane do not get to see a packet: it is another protocol's, or QUIC's.
fn is_for_no_data_socket(switch: &Switch, packet: &[u8]) -> bool {
    match switch.find(packet) {
        Some(place) => place.over_udp && place.length > 0 && packet[place.at] >= FIRST_QUIC_BYTE,
        None => true,
    }
}

/// The link that a frame says it is on.
fn link_of<'s>(frame: &[u8], switch: &'s Switch) -> Option<&'s fixtures::Link> {
    let at = switch.find(frame)?.at + 8;
    switch.link(u32::from_be_bytes(*frame.get(at..)?.first_chunk()?))
}

/// A frame that is often right, and otherwise wrong in one or a few ways.
fn random_frame(random: &mut Random, switch: &Switch) -> Vec<u8> {
    let link = &switch.links[random.below(switch.links.len())];
    let route = &switch.routes[random.below(switch.routes.len())];
    let mut frame = Frame {
        link_id: link.id,
        key: fixtures::key(&link.rx_keys[0]),
        link_counter: match link.taken[..] {
            [] => random.next() as u32 as u64,
            // Around those, some of them.
            _ => random.one_of(&link.taken) + random.below(3) as u64,
        },
        hop_limit: random.one_of(&[0, 1, 2, 3, 64, 64, 64, 255]),
        egress_set: random.one_of(&[0, 0, 3, 255]),
        egress_bits: match random.below(5) {
            0 => random.next(),
            1 => 0,
            2 => 1 << switch.own_bit,
            _ => 1 << random.below(20),
        },
        destination: fixtures::array(&route.name),
        source: match random.below(16) {
            0 => std::array::from_fn(|_| random.next() as u8),
            _ => match switch.routes.iter().find(|route| route.sources.contains(&link.id)) {
                Some(source) => fixtures::array(&source.name),
                None => fixtures::array(&link.peer),
            },
        },
        payload: vec![random.next() as u8; random.one_of(&[0, 1, 64, 500, 505, 1404, 1405, 1500])],
        padding: random.one_of(&[0, 0, 0, 1, 30]),
        carrier: switch.links[random.below(switch.links.len())].arrives_in(),
        ..Frame::default()
    };
    match random.below(24) {
        0 => frame.version_type = random.next() as u8,
        1 => frame.header_words = random.next() as u8,
        2 => frame.payload_len = Some(random.next() as u16),
        3 => frame.link_id = random.next() as u32,
        4 => frame.tag = Some(random.next()),
        5 => frame.ethertype = random.next() as u16,
        6 => frame.destination = std::array::from_fn(|_| random.next() as u8),
        7 => frame.version_type = random.one_of(&[0x11, 0x12, 0x14]),
        8 => frame.flags = 0x40,
        _ => {}
    }
    let mut bytes = frame.bytes();
    match random.below(12) {
        0 => bytes.truncate(14 + random.below(bytes.len() - 14)),
        1 => bytes.resize(bytes.len() + random.below(64), 0),
        2 => {
            let at = random.below(bytes.len().min(62));
            bytes[at] ^= 1 << random.below(8);
        }
        3 => {
            let at = random.below(bytes.len());
            bytes[at] ^= 1 << random.below(8);
        }
        _ => {}
    }
    bytes
}

/// A linear congruential generator: the same frames in every run.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        self.0 ^ self.0 >> 29
    }

    fn below(&mut self, limit: usize) -> usize {
        (self.next() >> 8) as usize % limit
    }

    fn one_of<T: Copy>(&mut self, values: &[T]) -> T {
        values[self.below(values.len())]
    }
}
