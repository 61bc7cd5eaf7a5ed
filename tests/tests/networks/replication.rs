//! Frames copied to several links, over real interfaces: every copy is compared byte for byte, and
//! counted.

use std::collections::HashSet;
use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use gdp_dataplane::group_slots::Member;
use gdp_dataplane::kernel::{KernelPlane, Mode, pinned_stats};
use gdp_dataplane::{PinLocation, PlaneConfig, pins};
use gdp_link::port::Interface;
use gdp_tests::Tools;
use gdp_tests::fabric::Mounted;
use gdp_tests::frames::fixtures::{self, Bytes, Fixtures, Verdict};
use gdp_tests::netns::Door;
use gdp_tests::process::Process;
use gdp_tests::wait::{TIMEOUT, wait_for};
use gdp_wire::table::{MAX_COPIED_FRAME, MAX_COPIES};
use gdp_wire::{Counter, LinkEntry, LocalAddress, Name};

use crate::star::{Far, Leaf, OWN_BIT, Plane, Star, Switch, WRITER, check_copy, readers, xdp};
use serde_json::{Value, json};

const TOPIC: Name = Name::from_bytes([0xd0; 32]);
const OTHER: Name = Name::from_bytes([0xe0; 32]);

const FRAMES: u64 = 100;

/// The expected receivers of a copy, with its egress bits.
type Expected = Vec<(Leaf, u64)>;

#[test]
fn readers_behind_interfaces_of_their_own() -> Result<()> {
    for count in [2, 8, 64] {
        copies_to(readers(count, count + 1), count + 1).with_context(|| format!("{count} readers"))?;
    }
    Ok(())
}

#[test]
fn readers_behind_one_interface() -> Result<()> {
    for count in [2, 8, 64] {
        copies_to(readers(count, 2), 2).with_context(|| format!("{count} readers"))?;
    }
    Ok(())
}

/// The writer's segment also has readers. The writer is not a reader; and as a reader it gets no
/// copy either.
#[test]
fn readers_behind_the_writers_interface() -> Result<()> {
    copies_to(readers(8, 1), 1)?;
    let mut group = readers(4, 1);
    let expected = onto(&group, 0);
    group.push(WRITER);
    let mut site = Site::new(1, 1500, &group)?;
    site.switch.set_route(TOPIC, OWN_BIT, &group)?;
    site.exchange(WRITER, TOPIC, 0, 600, &expected)
}

#[test]
fn bits_partition_over_neighbours() -> Result<()> {
    let neighbour = |index, interface, reach| Leaf { index, interface, reach };
    let (west, north) = (neighbour(2, 0, 0b11), neighbour(3, 1, 0b100));
    let (east, south) = (neighbour(4, 2, 0b1000), neighbour(6, 2, 1 << 63));
    let local = [Leaf { index: 7, interface: 1, reach: 0 }, Leaf { index: 8, interface: 2, reach: 0 }];
    let links = [&[WRITER, west, north, east, south][..], &local].concat();
    let mut site = Site::new(3, 1500, &links)?;
    site.switch.set_route(TOPIC, OWN_BIT | 0b1001 | 1 << 63, &local)?;

    let edge = [onto(&local, 0), vec![(west, 1), (east, 0b1000), (south, 1 << 63)]].concat();
    site.exchange(WRITER, TOPIC, 0, 600, &edge).context("from the writer")?;
    let transit = [(north, 0b100), (east, 0b1000)];
    site.exchange(west, OTHER, 0b1111, 600, &transit).context("in transit; its own bits are not sent back")?;
    let both = [onto(&local, 0), vec![(north, 0b100)]].concat();
    site.exchange(west, TOPIC, OWN_BIT | 0b101, 600, &both).context("in transit, and here")
}

/// Copies and frames for one link leave on the same interface, in the same batches.
#[test]
fn copies_and_single_frames_share_an_interface() -> Result<()> {
    let group = readers(4, 2);
    let mut site = Site::new(2, 1500, &[&[WRITER], &group[..]].concat())?;
    site.switch.set_route(TOPIC, OWN_BIT, &group)?;
    site.switch.set_route(OTHER, OWN_BIT, &group[..1])?;
    site.star.take_in_batches()?;
    let mut sent = Vec::new();
    for i in 0..4 * FRAMES {
        let frame = site.far.next_frame(&WRITER, if i % 2 == 0 { TOPIC } else { OTHER }, 300);
        site.far.send(&frame)?;
        site.far.keep_pace(&group[1..], i / 2)?;
        sent.push(frame);
    }
    site.far.wait_for_frames(&group[..1], 4 * FRAMES)?;
    site.far.wait_for_frames(&group[1..], 2 * FRAMES)?;
    let mut got = site.far.take();
    for (leaf, step) in group.iter().zip([1, 2, 2, 2]) {
        let got = got.remove(&leaf.peer_id()).unwrap_or_default();
        ensure!(got.len() == sent.len() / step, "{leaf:?} got {}", got.len());
        got.iter()
            .zip(sent.iter().step_by(step))
            .try_for_each(|(got, sent)| check_copy(got, sent, leaf, 0).map(drop))?;
    }
    let expected = (2 * FRAMES, 2 * FRAMES * 4 + 2 * FRAMES);
    let counted = (site.switch.count(Counter::Replicated)?, site.switch.count(Counter::Delivered)?);
    ensure!(counted == ((expected.0, 0), (expected.1, 0)), "{:?}", site.switch.counted()?);
    Ok(())
}

/// Neighbours without copies share the interfaces of readers. The kernel sends in batches, and must
/// also flush a batch whose last copies are dropped.
#[test]
fn nothing_waits_behind_copies_that_nobody_wants() -> Result<()> {
    let group = readers(3, 4);
    let idle = (0..40).map(|i| Leaf { index: 100 + i, interface: i as usize % 4, reach: 1 << (10 + i) });
    let links: Vec<Leaf> = [WRITER].into_iter().chain(group.iter().copied()).chain(idle).collect();
    let mut site = Site::new(4, 1500, &links)?;
    site.switch.set_route(TOPIC, OWN_BIT, &group[..2])?;
    site.switch.set_route(OTHER, OWN_BIT, &group[1..])?;
    site.star.take_in_batches()?;
    let mut sent = Vec::new();
    for round in 1..=60 {
        for i in 0..32 {
            let frame = site.far.next_frame(&WRITER, if i % 8 < 6 { TOPIC } else { OTHER }, 300);
            site.far.send(&frame)?;
            sent.push(frame);
        }
        // No later frame flushes a pending batch.
        for (leaf, frames) in group.iter().zip([24, 32, 8]) {
            site.far.wait_for_frames(&[*leaf], frames * round).with_context(|| format!("in round {round}"))?;
        }
    }
    let got = site.far.take();
    for leaf in &group {
        for got in &got[&leaf.peer_id()] {
            check_copy(got, &sent[number(got) as usize - 1], leaf, 0)?;
        }
    }
    let lost = site.switch.count(Counter::RedirectLost)?;
    ensure!(lost == (0, 0), "copies that nobody needs are no losses: {:?}", site.switch.counted()?);
    Ok(())
}

/// One reader is behind an interface that the kernel cannot send to: the userspace plane makes all
/// copies. Once the kernel can send to it, the kernel makes them.
#[test]
fn a_reader_that_the_kernel_cannot_reach() -> Result<()> {
    let group = readers(3, 3);
    let star = Star::build(3, 1500)?;
    star.set_gro(2, "off")?;
    let mut site = Site::on(star, &[&[WRITER], &group[..]].concat())?;
    site.switch.set_route(TOPIC, OWN_BIT, &group)?;
    site.exchange_by(Plane::Userspace, WRITER, TOPIC, 0, 600, &onto(&group, 0))?;
    site.star.set_gro(2, "on")?;
    site.switch.change(|planes| planes.refresh())??;
    site.exchange(WRITER, TOPIC, 0, 600, &onto(&group, 0))?;
    site.star.set_gro(2, "off")?;
    site.switch.change(|planes| planes.refresh())??;
    site.exchange_by(Plane::Userspace, WRITER, TOPIC, 0, 600, &onto(&group, 0))
}

#[test]
fn beyond_its_bounds_the_kernel_leaves_copies_to_userspace() -> Result<()> {
    let group = readers(MAX_COPIES as usize + 2, 2);
    let mut site = Site::new(2, 9000, &[&[WRITER], &group[..]].concat())?;
    site.switch.set_route(TOPIC, OWN_BIT, &group)?;
    site.exchange_by(Plane::Userspace, WRITER, TOPIC, 0, 300, &onto(&group, 0)).context("too many")?;
    let most = &group[..MAX_COPIES as usize];
    site.switch.set_route(TOPIC, OWN_BIT, most)?;
    site.exchange(WRITER, TOPIC, 0, 300, &onto(most, 0)).context("as many as it can")?;

    let few = &group[..2];
    site.switch.set_route(TOPIC, OWN_BIT, few)?;
    site.exchange(WRITER, TOPIC, 0, MAX_COPIED_FRAME, &onto(few, 0)).context("as large as it can")?;
    for length in [MAX_COPIED_FRAME + 1, 8900] {
        site.exchange_by(Plane::Userspace, WRITER, TOPIC, 0, length, &onto(few, 0))
            .with_context(|| format!("{length} bytes"))?;
    }
    Ok(())
}

/// Links return on other interfaces, disappear, and are replaced by others.
#[test]
fn links_move_and_go() -> Result<()> {
    let mut group = readers(6, 4);
    let mut site = Site::new(4, 1500, &[&[WRITER], &group[..]].concat())?;
    site.switch.set_route(TOPIC, OWN_BIT, &group)?;
    site.exchange(WRITER, TOPIC, 0, 600, &onto(&group, 0))?;
    for (reader, interface) in [(0, 2), (1, 3), (4, 0)] {
        group[reader].interface = interface;
        site.switch.set_link(&group[reader], 1500)?;
        site.exchange(WRITER, TOPIC, 0, 600, &onto(&group, 0)).with_context(|| format!("moved {reader}"))?;
    }
    let gone = group.remove(2);
    site.switch.change(|planes| planes.remove_link(gone.id()))??;
    site.exchange(WRITER, TOPIC, 0, 600, &onto(&group, 0)).context("gone")?;
    site.switch.set_link(&gone, 1500)?;
    group.insert(2, gone);
    site.exchange(WRITER, TOPIC, 0, 600, &onto(&group, 0)).context("back")
}

/// A reader that stays misses no copy and gets none twice while others come and go.
#[test]
fn readers_come_and_go_under_traffic() -> Result<()> {
    const CHANGES: usize = 150;
    let all = readers(12, 4);
    let (stay, guests) = all.split_at(4);
    let mut site = Site::new(4, 1500, &[&[WRITER], &all[..]].concat())?;
    site.switch.set_route(TOPIC, OWN_BIT, stay)?;
    let Site { switch, far, .. } = &mut site;
    let ended = std::sync::atomic::AtomicBool::new(false);
    let (sent, changes) = std::thread::scope(|scope| {
        let changes = scope.spawn(|| {
            let changed = (0..CHANGES).try_for_each(|round| {
                let here = |i: &usize| !(round * 7 + i * 5).is_multiple_of(3) && round % 8 >= *i % 4;
                let come: Vec<Leaf> = (0..guests.len()).filter(here).map(|i| guests[i]).collect();
                if round % 10 == 0 {
                    let guest = &guests[round / 10 % guests.len()];
                    switch.change(|planes| planes.remove_link(guest.id()))??;
                    switch.set_link(guest, 1500)?;
                }
                switch.set_route(TOPIC, OWN_BIT, &[stay, &come[..]].concat())
            });
            ended.store(true, std::sync::atomic::Ordering::Relaxed);
            changed
        });
        let mut sent = Vec::new();
        let result = (|| -> Result<()> {
            while !ended.load(std::sync::atomic::Ordering::Relaxed) {
                let frame = far.next_frame(&WRITER, TOPIC, 300);
                far.send(&frame)?;
                sent.push(frame);
                far.keep_pace(stay, sent.len() as u64)?;
            }
            far.wait_for_frames(stay, sent.len() as u64)
        })();
        (result.map(|()| sent), changes.join())
    });
    changes.map_err(|_| anyhow::anyhow!("the changes panicked"))??;
    let sent = sent.with_context(|| format!("{:?}", site.switch.counted()))?;
    ensure!(sent.len() > CHANGES, "only {} frames", sent.len());
    let mut got = site.far.take();
    for leaf in stay {
        let got = got.remove(&leaf.peer_id()).unwrap_or_default();
        let numbers: HashSet<u64> = got.iter().map(|frame| number(frame)).collect();
        ensure!(got.len() == sent.len() && numbers.len() == sent.len(), "{leaf:?} got {} of {}", got.len(), sent.len());
    }
    for leaf in &all {
        let got = got.remove(&leaf.peer_id()).unwrap_or_default();
        let numbers: HashSet<u64> = got.iter().map(|frame| number(frame)).collect();
        ensure!(got.len() == numbers.len(), "{leaf:?} got {} twice", got.len() - numbers.len());
        got.iter().try_for_each(|got| check_copy(got, &sent[number(got) as usize - 1], leaf, 0).map(drop))?;
    }
    let (kernel, userspace) = site.switch.count(Counter::Replicated)?;
    ensure!(kernel + userspace == sent.len() as u64, "{:?}", site.switch.counted()?);
    ensure!(kernel > userspace, "hardly in the kernel: {:?}", site.switch.counted()?);
    Ok(())
}

/// A daemon is killed and two successors follow. No reader misses a copy or gets one twice, and the
/// group persists.
#[test]
fn no_copy_is_lost_when_the_switch_is_killed_and_comes_again() -> Result<()> {
    let group = process_readers();
    let star = Star::build(PROCESS_INTERFACES, 1500)?;
    let folder = tempfile::tempdir()?;
    let bpffs = Mounted(folder.path().join(BPFFS));
    let mut far = Far::start(&star)?;
    let mut sent = Vec::new();
    let mut traffic = |more: &mut dyn FnMut(usize) -> Result<bool>| -> Result<()> {
        let begun = sent.len();
        while more(sent.len() - begun)? {
            let frame = far.next_frame(&WRITER, TOPIC, 300);
            far.send(&frame)?;
            sent.push(frame);
            far.keep_pace(&group, sent.len() as u64)?;
        }
        Ok(())
    };
    let start = |label: &str| -> Result<Process> {
        let mut command = star.switch.command(std::env::current_exe()?)?;
        command.args(["--exact", "replication::switch_process", "--nocapture"]).env(SWITCH_PROCESS, folder.path());
        Process::spawn(label, command, folder.path())
    };
    let is_up = |process: &mut Process| -> Result<Option<Value>> {
        process.check_alive()?;
        Ok(process.json_lines().pop())
    };

    let mut process = start("first")?;
    let mut up = wait_for("the switch", TIMEOUT, || is_up(&mut process))?;
    ensure!(up["left"] == json!([]), "{up}");
    for label in ["second", "third"] {
        traffic(&mut |frames| Ok(frames < 300))?;
        process.kill()?;
        traffic(&mut |frames| Ok(frames < 300)).context("without a daemon")?;
        process = start(label)?;
        traffic(&mut |_| {
            up = is_up(&mut process)?.unwrap_or_default();
            Ok(up.is_null())
        })
        .with_context(|| format!("while the {label} came"))?;
        let ids: Vec<u32> = group.iter().map(Leaf::id).collect();
        ensure!(up["left"] == json!([ids]), "the {label} found {up}");
    }
    traffic(&mut |frames| Ok(frames < 300))?;
    far.wait_for_frames(&group, sent.len() as u64)?;

    let mut got = far.take();
    for leaf in &group {
        let got = got.remove(&leaf.peer_id()).unwrap_or_default();
        ensure!(got.len() == sent.len(), "{leaf:?} got {} of {}", got.len(), sent.len());
        got.iter().zip(&sent).try_for_each(|(got, sent)| check_copy(got, sent, leaf, 0).map(drop))?;
    }
    let pins = pins::find(&bpffs.0)?.pop().context("pins")?;
    let counted = pinned_stats(&pins.folder)?.counters;
    let of = |wanted| counted.iter().find(|(counter, _)| *counter == wanted).map(|(_, count)| *count);
    ensure!(of(Counter::Replicated) == Some(sent.len() as u64) && of(Counter::Slow) == Some(0), "{counted:?}");
    Ok(())
}

/// Variable with the folder of the process, which does nothing without it.
const SWITCH_PROCESS: &str = "GDP_TEST_SWITCH_PROCESS";
const PROCESS_INTERFACES: usize = 3;
const BPFFS: &str = "bpf";

fn process_readers() -> Vec<Leaf> {
    readers(5, PROCESS_INTERFACES)
}

/// The process that the test above kills; not a test itself.
#[test]
fn switch_process() -> Result<()> {
    let Some(folder) = std::env::var_os(SWITCH_PROCESS) else { return Ok(()) };
    let pins = PinLocation { bpffs: PathBuf::from(folder).join(BPFFS), switch: TOPIC, replaces: false };
    let config = PlaneConfig { pins: Some(pins), ..xdp(Tools::beside_this_test()?.ebpf_object()?) };
    let mut switch = Switch::open(config, Door::here()?, PROCESS_INTERFACES)?;
    let left = switch.planes().left().map_or(&[][..], |left| &left.routes);
    let left: Vec<_> = left.iter().map(|(_, route)| route.readers.clone()).collect();
    if left.is_empty() {
        switch.change(|planes| planes.set_own_bit(OWN_BIT))??;
        for leaf in process_readers().iter().chain([&WRITER]) {
            switch.set_link(leaf, 1500)?;
        }
        switch.set_route(TOPIC, OWN_BIT, &process_readers())?;
    }
    println!("\n{}", json!({ "left": left }));
    loop {
        std::thread::park();
    }
}

/// Runs every fixture that makes copies, and compares the copies.
#[test]
fn every_fixture_with_copies() -> Result<()> {
    let Fixtures { switch, cases, .. } = fixtures::read();
    let star = Star::build(6, 9000)?;
    let far = Far::start(&star)?;
    let _inside = star.switch.enter()?;
    let mut plane = KernelPlane::load(&Tools::beside_this_test()?.ebpf_object()?, 1024)?;
    let mut ports = Vec::new();
    for port in 0..6 {
        let ifindex = Interface::find(&format!("p{port}"))?.index;
        plane.set_port(port, ifindex)?;
        ports.push(ifindex);
    }
    plane.programs.attach(ports[0], Mode::Native)?;
    plane.set_config(switch.config())?;
    let addresses = switch.own_addresses().into_iter().map(|own| LocalAddress::new(own.ip(), own.port()));
    plane.set_addresses(&addresses.collect())?;
    for link in switch.links() {
        let port = ports.get(link.port as usize).copied().unwrap_or(link.port);
        plane.set_link(&LinkEntry { port, ..link })?;
    }
    for (name, entry, permitted) in switch.routes() {
        permitted.iter().try_for_each(|permit| plane.permit(permit))?;
        plane.set_route(&name, entry)?;
    }
    plane.set_next_hops(&switch.next_hops())?;
    for (group, links, served) in switch.kernel_groups() {
        let interface = |link: &&fixtures::Link| ports.get(link.port? as usize).copied();
        let members = links.iter().filter_map(|link| Some(Member { link: link.id, interface: interface(link)? }));
        plane.set_group(group, &members.collect::<Vec<_>>(), served)?;
    }

    let copied = cases.iter().filter(|case| case.kernel.verdict == Verdict::Copy);
    for case in copied.clone() {
        for link in &switch.links {
            plane.link_memory().begin(link.id);
            plane.link_memory().set_count(link.id, link.tx_counter);
        }
        let before = plane.counters()?;
        far.send_bytes(&case.frame.bytes())?;
        let mut wanted: Vec<_> = case.kernel.copies.iter().map(|copy| copy.counter.as_str()).collect();
        wanted.push(Counter::Replicated.as_str());
        wanted.sort_unstable();
        let frames = || case.kernel.copies.iter().filter_map(|copy| copy.frame.as_ref());
        let mut counted = Vec::new();
        let all_there = wait_for(&case.name, TIMEOUT, || {
            counted.clear();
            for (counter, (before, after)) in Counter::ALL.iter().zip(before.into_iter().zip(plane.counters()?)) {
                counted.extend((before..after).map(|_| counter.as_str()));
            }
            counted.sort_unstable();
            Ok((counted == wanted && far.total() == frames().count()).then_some(()))
        });
        all_there.with_context(|| format!("wanted {wanted:?}, counted {counted:?}; {} frames", far.total()))?;
        let mut got: Vec<_> = far.take().into_values().flatten().map(|frame| Bytes::new(&frame)).collect();
        got.sort();
        ensure!(got.iter().eq(frames()), "{}:\n     got {got:?}\nexpected {:?}", case.name, case.kernel.copies);
    }
    ensure!(copied.count() > 10);
    Ok(())
}

fn copies_to(group: Vec<Leaf>, interfaces: usize) -> Result<()> {
    let mut site = Site::new(interfaces, 1500, &[&[WRITER], &group[..]].concat())?;
    site.switch.set_route(TOPIC, OWN_BIT, &group)?;
    site.exchange(WRITER, TOPIC, 0, 1400, &onto(&group, 0))
}

fn onto(leaves: &[Leaf], bits: u64) -> Expected {
    leaves.iter().map(|leaf| (*leaf, bits)).collect()
}

/// Returns the number that [`Far::next_frame`] gave a frame.
fn number(frame: &[u8]) -> u64 {
    frame[110..118].iter().fold(0, |number, byte| number << 8 | u64::from(*byte))
}

struct Site {
    // First field: it detaches while the interfaces exist.
    switch: Switch,
    far: Far,
    star: Star,
}

impl Site {
    fn new(interfaces: usize, mtu: u32, links: &[Leaf]) -> Result<Self> {
        Self::on(Star::build(interfaces, mtu)?, links)
    }

    fn on(star: Star, links: &[Leaf]) -> Result<Self> {
        let switch = star.start(xdp(Tools::beside_this_test()?.ebpf_object()?), links)?;
        ensure!(switch.planes().report().iter().all(|report| report.kind == "xdp-native"), "no native XDP");
        Ok(Self { switch, far: Far::start(&star)?, star })
    }

    fn exchange(&mut self, from: Leaf, to: Name, bits: u64, length: usize, expected: &[(Leaf, u64)]) -> Result<()> {
        self.exchange_by(Plane::Kernel, from, to, bits, length, expected)
    }

    /// Sends frames. Each expected receiver must get each of them, correctly addressed and from
    /// that plane. No other receiver may get any.
    fn exchange_by(
        &mut self,
        plane: Plane,
        from: Leaf,
        to: Name,
        bits: u64,
        length: usize,
        expected: &[(Leaf, u64)],
    ) -> Result<()> {
        let counters = [Counter::Replicated, Counter::Delivered, Counter::Forwarded];
        let before = counters.map(|counter| self.switch.count(counter));
        let leaves: Vec<Leaf> = expected.iter().map(|(leaf, _)| *leaf).collect();
        let mut sent = Vec::new();
        for i in 0..FRAMES {
            let frame = gdp_tests::frames::Frame { egress_bits: bits, ..self.far.next_frame(&from, to, length) };
            self.far.send(&frame)?;
            self.far.keep_pace(&leaves, i)?;
            sent.push(frame);
        }
        let counted = |switch: &Switch| format!("{:?}", switch.counted());
        self.far.wait_for_frames(&leaves, FRAMES).with_context(|| counted(&self.switch))?;
        let mut got = self.far.take();
        for (leaf, bits) in expected {
            let got = got.remove(&leaf.peer_id()).unwrap_or_default();
            ensure!(got.len() == sent.len(), "{leaf:?} got {}", got.len());
            let mut before = None;
            for (got, sent) in got.iter().zip(&sent) {
                let count = check_copy(got, sent, leaf, *bits)?;
                ensure!(before.is_none_or(|before| count == before + 1), "{leaf:?}: count {count} after {before:?}");
                before = Some(count);
            }
        }
        ensure!(got.is_empty(), "nothing was for {:x?}", got.keys());

        let switches = leaves.iter().filter(|leaf| leaf.reach != 0).count() as u64;
        let copies = [1, leaves.len() as u64 - switches, switches];
        for ((counter, before), copies) in counters.into_iter().zip(before).zip(copies) {
            let before = before?;
            let wanted = if plane == Plane::Kernel { (copies * FRAMES, 0) } else { (0, copies * FRAMES) };
            // The userspace plane counts a frame after sending it, so the frame may arrive earlier.
            wait_for(&format!("{counter:?} to grow by {wanted:?}"), TIMEOUT, || {
                let after = self.switch.count(counter)?;
                Ok(((after.0 - before.0, after.1 - before.1) == wanted).then_some(()))
            })
            .with_context(|| counted(&self.switch))?;
        }
        Ok(())
    }
}
