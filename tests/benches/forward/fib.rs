//! The FIB with a million names, compared with the kernel's own hash of the same names: the cost of
//! a lookup, the rate of route changes, and the cost of lookups during changes.

use std::cell::RefCell;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Result, ensure};
use gdp_dataplane::fib::Fib;
use gdp_tests::measure::figure::{Aim, Figure, Measure, Unit};
use gdp_tests::measure::rounds::{Contender, Sample, alternate};
use gdp_wire::{FibEntry, Name};

use crate::Bench;
use crate::lookups::{self, Lookups};

/// Names in both tables.
const NAMES: u32 = 1 << 20;

/// Names looked up in turn: one cache line, a set that caches can contain, the whole table.
const ASKED: [(&str, u64); 3] = [("one name", 1), ("random of 1024 names", 1 << 10), (ALL, NAMES as u64)];
const ALL: &str = "random of 1 M names";

/// Lookups per measurement.
const TIMES: u32 = 500_000;

const NONE: &str = "no lookup";
const FLAT: &str = "FIB";
const HASH: &str = "kernel hash";
const CHANGING: &str = "FIB, routes changing";
const FLAT_ALONE: &str = "FIB, without what is around";
const HASH_ALONE: &str = "kernel hash, likewise";

type Routes = Vec<(Name, FibEntry)>;

pub fn run(bench: &Bench) -> Result<Vec<Figure>> {
    let routes = |version| (0..NAMES.into()).map(|i| (lookups::name(i), lookups::route(i, version))).collect();
    let versions: [Routes; 2] = [routes(0), routes(1)];
    let (mut asks, mut fib, mut hash) = lookups::load(&bench.bench_object, NAMES)?;
    let growing = rate(&versions[0], |routes| Ok(fib.insert_all(routes)?))?;
    let filled =
        rate(&versions[0], |routes| Ok(routes.iter().try_for_each(|(name, entry)| hash.insert(name, entry, 0))?))?;
    let mut updates = updates(bench, &mut fib, &versions)?;
    updates.push(Measure::new(FLAT, "added, growing from the smallest table", vec![growing]));
    updates.push(Measure::new(HASH, "added, a system call each", vec![filled]));
    ensure!((0..NAMES.into()).all(|i| fib.get(&lookups::name(i)).is_some_and(|entry| lookups::is_route(i, entry))));

    let updates = Figure::new("fib-updates", "Changes of a FIB of 1 M names", Unit::NamesPerSecond, updates)
        .aim(FLAT, "added", Aim::AtLeast(5e6))
        .aim(FLAT, "changed", Aim::AtLeast(5e6));
    Ok(vec![lookup_figure(bench, &mut asks, &mut fib, &versions)?, updates])
}

fn lookup_figure(bench: &Bench, asks: &mut Lookups, fib: &mut Fib, versions: &[Routes; 2]) -> Result<Figure> {
    let (asks, fib) = (RefCell::new(asks), RefCell::new(fib));
    let mut contenders = Vec::new();
    for (case, asked) in ASKED {
        for (series, program) in [(NONE, "lookup_none"), (FLAT, "lookup_flat"), (HASH, "lookup_hash")] {
            let asks = &asks;
            contenders.push(Contender::new(series, case, move || cost(&mut asks.borrow_mut(), program, asked)));
        }
    }
    contenders.push(Contender::new(CHANGING, ALL, || {
        while_changing(&mut fib.borrow_mut(), versions, || cost(&mut asks.borrow_mut(), "lookup_flat", NAMES.into()))
    }));
    let mut measures = alternate(bench.rounds, contenders)?;
    for (alone, series) in [(FLAT_ALONE, FLAT), (HASH_ALONE, HASH)] {
        for (case, _) in ASKED {
            let rounds = |series| measures.iter().find(|m| m.series == series && m.case == case).map(|m| &m.rounds);
            let (Some(all), Some(around)) = (rounds(series), rounds(NONE)) else { continue };
            let rounds = all.iter().zip(around).map(|(all, around)| all - around).collect();
            measures.push(Measure::new(alone, case, rounds));
        }
    }
    let title = "A lookup in a FIB of 1 M names, by test runs";
    Ok(Figure::new("fib", title, Unit::Nanoseconds, measures)
        .compare(HASH, FLAT, |case| (case == ALL).then_some(Aim::AtLeast(2.5)))
        .compare(HASH_ALONE, FLAT_ALONE, |_| None)
        .compare(FLAT, CHANGING, |_| Some(Aim::AtLeast(0.9))))
}

/// Measures the update rates of one thread on a table that has grown. All routes exist before and
/// after.
fn updates(bench: &Bench, fib: &mut Fib, [first, second]: &[Routes; 2]) -> Result<Vec<Measure>> {
    let mut rates: [Vec<f64>; 3] = Default::default();
    for _ in 0..bench.rounds.max(1) {
        gdp_tests::wait::check_interrupt()?;
        let [added, changed, removed] = &mut rates;
        changed.push(rate(second, |routes| Ok(fib.insert_all(routes)?))?);
        removed.push(rate(second, |routes| {
            ensure!(routes.iter().all(|(name, _)| fib.remove(name)), "a name was not there");
            Ok(())
        })?);
        added.push(rate(first, |routes| Ok(fib.insert_all(routes)?))?);
    }
    let cases = ["added", "changed", "removed"].into_iter().zip(rates);
    Ok(cases.map(|(case, rounds)| Measure::new(FLAT, case, rounds)).collect())
}

/// Returns the result of `measure` while a thread changes routes as fast as it can.
fn while_changing(fib: &mut Fib, versions: &[Routes; 2], measure: impl FnOnce() -> Result<Sample>) -> Result<Sample> {
    let (changing, over) = (AtomicBool::new(false), AtomicBool::new(false));
    std::thread::scope(|scope| {
        let changes = scope.spawn(|| {
            for part in versions.iter().cycle().flat_map(|routes| routes.chunks(4096)) {
                if over.load(Ordering::Relaxed) {
                    break;
                }
                fib.insert_all(part)?;
                changing.store(true, Ordering::Relaxed);
            }
            anyhow::Ok(())
        });
        while !changing.load(Ordering::Relaxed) && !changes.is_finished() {
            std::thread::yield_now();
        }
        let sample = measure();
        over.store(true, Ordering::Relaxed);
        changes.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
        sample
    })
}

fn cost(asks: &mut Lookups, program: &str, asked: u64) -> Result<Sample> {
    let (value, found) = asks.run(program, asked, asked, TIMES)?;
    ensure!(found.right == u64::from(TIMES), "{program}, {asked} names: {found:?}");
    Ok(Sample { value, ..Sample::default() })
}

/// Returns routes per second.
fn rate(routes: &[(Name, FibEntry)], change: impl FnOnce(&[(Name, FibEntry)]) -> Result<()>) -> Result<f64> {
    let start = Instant::now();
    change(routes)?;
    Ok(routes.len() as f64 / start.elapsed().as_secs_f64())
}
