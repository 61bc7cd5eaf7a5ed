//! The XDP switch under `BPF_PROG_TEST_RUN`: the real program in the real kernel, one frame at a
//! time. The kernel sends nothing. It looks up next hops of links over UDP in a network namespace's
//! routing table.

use std::sync::Barrier;

use anyhow::{Context, Result, ensure};
use gdp_dataplane::kernel::{self, Buffers, KernelPlane, LoadError, UpdateError, XdpAction};
use gdp_dataplane::link_memory::LinkMemory;
use gdp_dataplane::pins::{self, PinLocation, Pins};
use gdp_dataplane::userspace::{Outcome, handle};
use gdp_tests::Tools;
use gdp_tests::frames::Frame;
use gdp_tests::frames::fixtures::{self, Expected, Fixtures, Switch, Verdict};
use gdp_tests::netns::execute;
use gdp_tests::programs::{Executable as _, Program};
use gdp_wire::{Counter, FibEntry, Name, replay};

use crate::planes::dpdk::DpdkSwitch;
use crate::planes::{Site, fill, is_for_no_data_socket, run, run_userspace, user_tables, user_tables_with};

#[test]
fn every_fixture_through_the_kernel() -> Result<()> {
    let Fixtures { switch, cases, .. } = fixtures::read();
    let site = Site::build()?;
    // A test run splits longer frames into several buffers.
    const ONE_BUFFER: usize = 3000;
    let mut plane = site.kernel_plane(&switch)?;
    for (case, buffers) in cases.iter().flat_map(|case| [(case, Buffers::One), (case, Buffers::Several)]) {
        let frame = case.frame.bytes();
        if buffers == Buffers::One && frame.len() > ONE_BUFFER {
            continue;
        }
        reset(plane.link_memory(), &switch);
        let got = run(&mut plane, buffers, &frame).with_context(|| case.name.clone())?;
        let got = Expected::from(got);
        // The kernel makes the copies at their egress: see `replication`.
        let expected = Expected { copies: vec![], ..case.kernel.clone() };
        ensure!(got == expected, "{}, {buffers:?}:\n     got {got:?}\nexpected {expected:?}", case.name);
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
        let got = Expected::from(run_userspace(&tables, &switch, &case.frame.bytes()));
        ensure!(got == *expected, "{}:\n     got {got:?}\nexpected {expected:?}", case.name);
    }
    Ok(())
}

/// Where the kernel passes a frame that it cannot copy to the userspace plane, DPDK copies the
/// frame.
#[test]
fn every_fixture_through_dpdk() -> Result<()> {
    let Fixtures { switch, cases, .. } = fixtures::read();
    let mut beyond_the_kernel = Vec::new();
    for (case, gathers) in cases.iter().flat_map(|case| [(case, false), (case, true)]) {
        let mut plane = DpdkSwitch::new(&switch)?;
        reset(&plane.link_memory, &switch);
        let got = plane.fate(&case.frame.bytes(), gathers).map(Expected::from).with_context(|| case.name.clone())?;
        if got == case.kernel {
            continue;
        }
        let [slow, failed] = [Counter::Slow, Counter::RedirectFailed].map(Counter::as_str);
        let is_copied = case.kernel.counter == slow && Some(&got) == case.userspace.as_ref();
        // The kernel's configuration names a port that does not exist; DPDK knows its own ports.
        let is_left = case.kernel.counter == failed && got.counter == slow && got.verdict == Verdict::Pass;
        ensure!(is_copied || is_left, "{}:\n     got {got:?}\nexpected {:?}", case.name, case.kernel);
        if is_copied && gathers {
            beyond_the_kernel.push(&case.name);
        }
    }
    ensure!(beyond_the_kernel == ["one byte more than the kernel copies"], "{beyond_the_kernel:?}");
    Ok(())
}

/// The kernel and the userspace plane may receive frames of one link at the same time. Both get the
/// same frames in opposite order, and exactly one plane must forward each.
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
            let (mut sent, mut reader) = (Vec::new(), tables.reader());
            for round in frames.chunks(FRAMES) {
                together.wait();
                sent.extend(round.iter().rev().map(|frame| {
                    let outcome = handle(&mut frame[14..].to_vec(), false, &reader.enter());
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
            // An error must not block the other thread.
            in_kernel.extend(
                round.iter().map(|frame| kernel.programs.test_run(Buffers::One, frame).map(|(action, _)| action)),
            );
        }
        (in_kernel, in_userspace.join().expect("no panic"))
    });

    let mut won = [0, 0];
    for (frame, (kernel, (by_userspace, outcome))) in in_kernel.into_iter().zip(in_userspace).enumerate() {
        let by_kernel = kernel? == XdpAction::Redirect;
        ensure!(by_kernel != by_userspace, "frame {frame}: sent by the kernel: {by_kernel}; userspace: {outcome:?}");
        ensure!(by_userspace || outcome == Outcome::Drop(Counter::Replayed), "frame {frame}: {outcome:?}");
        won[usize::from(by_userspace)] += 1;
    }
    ensure!(won.iter().all(|won| *won > 100), "the planes hardly met: {won:?}");
    Ok(())
}

#[test]
fn arrivals_are_counted_by_link_and_busy_names_by_samples() -> Result<()> {
    const FRAMES: u64 = 4096;
    let Fixtures { switch, .. } = fixtures::read();
    let site = Site::build()?;
    let mut plane = site.kernel_plane(&switch)?;
    let (link, other, route) = (&switch.links[0], &switch.links[1], &switch.routes[0]);
    plane.link_memory().begin(link.id);
    for count in 1..=FRAMES {
        let frame = Frame {
            link_id: link.id,
            key: fixtures::key(&link.rx_keys[0]),
            link_counter: count,
            destination: fixtures::array(&route.name),
            source: fixtures::array(&link.peer),
            ..Frame::default()
        };
        plane.programs.test_run(Buffers::One, &frame.bytes())?;
        if count == 1 {
            plane.programs.test_run(Buffers::One, &frame.bytes())?;
            plane.programs.test_run(Buffers::One, &Frame { tag: Some(0), ..frame }.bytes())?;
        }
    }
    let arrivals = plane.tally().of(link.id)?;
    let counted = |counter: Counter| arrivals[counter as usize];
    ensure!((counted(Counter::Forwarded), counted(Counter::Replayed), counted(Counter::BadTag)) == (FRAMES, 1, 1));
    ensure!(arrivals.iter().sum::<u64>() == FRAMES + 2, "{arrivals:?}");
    ensure!(plane.tally().of(other.id)?.iter().all(|frames| *frames == 0));
    let busiest = plane.tally().busiest()?;
    let about = busiest.get(&Name::from_bytes(fixtures::array(&route.name))).copied().unwrap_or(0);
    ensure!((FRAMES / 2..FRAMES * 2).contains(&about) && busiest.len() == 1, "{busiest:?}");
    plane.begin_link(link.id)?;
    ensure!(plane.tally().of(link.id)?.iter().all(|frames| *frames == 0), "a new link begins with nothing");
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

/// A daemon that dies leaves its table, and possibly a larger one that was about to replace it.
#[test]
fn a_successor_takes_over_a_fib_that_has_grown() -> Result<()> {
    const NAMES: u32 = 5000;
    let Fixtures { switch, cases, .. } = fixtures::read();
    let case = cases.iter().find(|case| case.kernel.verdict == Verdict::Send).context("a frame that is sent")?;
    let bpffs = Bpffs(tempfile::tempdir()?);
    let open = || -> Result<KernelPlane> {
        let pins = Pins::open(&PinLocation { bpffs: bpffs.0.path().into(), switch: Name::default(), replaces: false })?;
        Ok(KernelPlane::load_pinned(&Tools::beside_this_test()?.ebpf_object()?, 3 * NAMES, Some(pins))?)
    };
    let forwards = |plane: &mut KernelPlane| -> Result<()> {
        reset(plane.link_memory(), &switch);
        let got = Expected::from(run(plane, Buffers::One, &case.frame.bytes())?);
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
    // Simulates a daemon that died when the larger table was ready but had not yet replaced the
    // other.
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

/// A folder in which [`Pins`] mounts a BPF file system.
struct Bpffs(tempfile::TempDir);

impl Drop for Bpffs {
    fn drop(&mut self) {
        let _ = execute(Program::Umount.command().arg("--lazy").arg(self.0.path()));
    }
}

fn reset(memory: &LinkMemory, switch: &Switch) {
    for link in &switch.links {
        memory.begin(link.id);
        memory.set_count(link.id, link.tx_counter);
        link.taken.iter().for_each(|count| assert!(replay::take(memory.window(link.id), *count)));
    }
}
