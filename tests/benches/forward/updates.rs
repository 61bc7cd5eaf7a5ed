//! Measures whether live frames are forwarded as fast while routes change. The path is one XDP
//! switch with a million other names. A thread replaces their routes, and the frames' own, through
//! the mapping as fast as it can.
//!
//! The generator, and with it the switch, has one CPU; the thread has another. A busy neighbour has
//! its own cost: shared caches and memory, or a shared core with two hardware threads. A second
//! measurement therefore makes the same changes to a FIB without readers.

use std::cell::RefCell;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use gdp_dataplane::kernel::{KernelPlane, Mode};
use gdp_link::port::Interface;
use gdp_tests::measure::cpu;
use gdp_tests::measure::figure::{Aim, Figure, Measure, Unit};
use gdp_tests::measure::rounds::{Contender, Sample, alternate};
use gdp_wire::{Counter, FibEntry, LinkEntry, Name, SwitchConfig};

use crate::path::{Kind, Path};
use crate::switch::{LEFT, Medium, RIGHT, TOPIC, link};
use crate::traffic::Traffic;
use crate::{Bench, lookups};

/// Capacity of the FIB when full: the name of the frames, and others.
const CAPACITY: u32 = 1 << 20;
const OTHERS: u64 = CAPACITY as u64 - 1;

/// The frames' own route changes once per this many routes.
const PART: usize = 4096;

const IDLE: &str = "no changes";
const ELSEWHERE: &str = "another FIB changes";
const CHANGING: &str = "the FIB changes";
const FORWARDED: &str = "forwarded, 1 hop";

type Routes = Vec<(Name, FibEntry)>;

pub fn run(bench: &Bench) -> Result<Vec<Figure>> {
    let path = Path::build(Kind::Cable, 1, bench)?;
    let planes = [start(&path, bench)?, KernelPlane::load(&bench.ebpf_object, CAPACITY)?].map(RefCell::new);
    let versions = [0, 1]
        .map(|version| -> Routes { (0..OTHERS).map(|i| (lookups::name(i), lookups::route(i, version))).collect() });
    for plane in &planes {
        change(&mut plane.borrow_mut(), &versions[0])?;
    }
    let traffic = RefCell::new(Traffic::new(path.chain(), path.frames(174), bench)?);
    let forward = || traffic.borrow_mut().rate(bench.duration());
    let changed = RefCell::new(Vec::new());
    let beside = |plane: &RefCell<KernelPlane>| -> Result<(Sample, f64)> {
        while_changing(&mut plane.borrow_mut(), &versions, forward)
    };
    let [plane, other] = &planes;
    let contenders = vec![
        Contender::new(IDLE, FORWARDED, forward),
        Contender::new(ELSEWHERE, FORWARDED, || Ok(beside(other)?.0)),
        Contender::new(CHANGING, FORWARDED, || {
            let (sample, rate) = beside(plane)?;
            changed.borrow_mut().push(rate);
            Ok(sample)
        }),
    ];
    let measures = alternate(bench.rounds, contenders)?;
    let counted = plane.borrow().counters()?;
    let others = counted.iter().sum::<u64>() - counted[Counter::Delivered as usize];
    ensure!(others == 0, "delivered and nothing else was to be counted: {counted:?}");

    let title = "Frames of 174 B through a switch with a FIB of 1 M names, while their routes change";
    let figure = Figure::new("live-updates", title, Unit::FramesPerSecond, measures)
        .compare(CHANGING, IDLE, |_| Some(Aim::AtLeast(0.9)))
        .compare(ELSEWHERE, IDLE, |_| None)
        .compare(CHANGING, ELSEWHERE, |_| None);
    // The first round warms up.
    let changed = vec![Measure::new("routes changed", "meanwhile", changed.into_inner().split_off(1))];
    let changes = Figure::new("live-updates-rate", "Routes changed meanwhile", Unit::NamesPerSecond, changed);
    Ok(vec![figure, changes])
}

/// Starts a switch between the two interfaces of a node. Its FIB is written without the daemon's
/// own tables, and therefore as fast as possible.
fn start(path: &Path, bench: &Bench) -> Result<KernelPlane> {
    let _inside = path.first_hop().enter()?;
    let mut plane = KernelPlane::load(&bench.ebpf_object, CAPACITY)?;
    plane.forgo_losses();
    plane.set_config(SwitchConfig { own_bit: 1, ethertype: gdp_wire::ETHERTYPE.into(), host_pair: 0 })?;
    for (id, interface, neighbour, ends) in [(LEFT, "l0", 0, (1, 2)), (RIGHT, "r0", 1, (2, 1))] {
        let port = Interface::find(interface)?.index;
        plane.set_port(port, port)?;
        plane.programs.attach(port, Mode::Native).with_context(|| format!("cannot attach to {interface}"))?;
        plane.begin_link(id)?;
        plane.set_link(&LinkEntry { id, port, ..link(true, neighbour, ends, Medium::Ethernet) })?;
    }
    Ok(plane)
}

/// Returns the result of `measure` while a thread changes routes, and the changes per second.
fn while_changing(
    plane: &mut KernelPlane,
    versions: &[Routes; 2],
    measure: impl FnOnce() -> Result<Sample>,
) -> Result<(Sample, f64)> {
    let (changes, over) = (AtomicU64::new(0), AtomicBool::new(false));
    std::thread::scope(|scope| {
        let thread = scope.spawn(|| {
            cpu::pin(cpu::OTHER)?;
            for part in versions.iter().cycle().flat_map(|routes| routes.chunks(PART)) {
                if over.load(Ordering::Relaxed) {
                    break;
                }
                change(plane, part)?;
                changes.fetch_add(part.len() as u64 + 1, Ordering::Relaxed);
            }
            anyhow::Ok(())
        });
        while changes.load(Ordering::Relaxed) == 0 && !thread.is_finished() {
            std::thread::yield_now();
        }
        let (start, before) = (Instant::now(), changes.load(Ordering::Relaxed));
        let sample = measure();
        let changed = changes.load(Ordering::Relaxed) - before;
        let rate = changed as f64 / start.elapsed().as_secs_f64();
        over.store(true, Ordering::Relaxed);
        thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
        Ok((sample?, rate))
    })
}

/// Replaces these routes, and that of the frames.
fn change(plane: &mut KernelPlane, routes: &[(Name, FibEntry)]) -> Result<()> {
    let topic = FibEntry { egress_bits: 1, local_link: RIGHT, writer_link: LEFT, ..FibEntry::default() };
    plane.set_route(&TOPIC, topic)?;
    Ok(routes.iter().try_for_each(|(name, route)| plane.set_route(name, *route))?)
}
