//! The FIB at scale, beside the kernel's own hash with the same names: what a lookup costs, how fast routes change, and what
//! lookups cost meanwhile.

use std::fmt;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Result, ensure};
use gdp_ctl::plane::fib::Fib;
use gdp_wire::{FibEntry, Name, flat};
use serde::Serialize;

use crate::lookups::{self, Lookups};

/// Names in both tables.
const NAMES: u32 = 1 << 20;

/// Names that are asked for in turn: one line, what caches hold, all of the table.
const ASKED: [u64; 3] = [1, 1 << 10, NAMES as u64];

/// Lookups in one measurement.
const TIMES: u32 = 1_000_000;

/// The medians of the rounds.
#[derive(Serialize)]
pub struct FibFigures {
    names: u32,
    /// Kernel memory, for each of the names.
    bytes_per_name: f64,
    lookups: Vec<LookupRow>,
    updates: Updates,
}

/// Nanoseconds for a random one of so many names, as `BPF_PROG_TEST_RUN` counts them.
#[derive(Serialize)]
struct LookupRow {
    asked: u64,
    /// Without a lookup.
    none: f64,
    flat: f64,
    hash: f64,
    /// How many times faster flat is than hash, and the same without what both do besides.
    times: f64,
    times_net: f64,
}

/// Names per second, by one thread.
#[derive(Serialize)]
struct Updates {
    /// Of a table that has room for them.
    added: f64,
    changed: f64,
    removed: f64,
    /// From the first table on, with all growth.
    added_growing: f64,
    /// One system call each.
    hash_added: f64,
    /// Lookups in all of the table: nanoseconds while nothing changes, and while another thread changes routes as fast as it can.
    lookup_idle: f64,
    lookup_meanwhile: f64,
}

/// `object`: `gdp-ebpf-bench`.
pub fn measure(object: &Path, rounds: usize) -> Result<FibFigures> {
    let routes =
        |version| -> Vec<_> { (0..NAMES.into()).map(|i| (lookups::name(i), lookups::route(i, version))).collect() };
    let versions = [routes(0), routes(1)];
    let [first, second] = &versions;
    let (mut asks, mut fib, mut hash) = lookups::load(object, NAMES)?;

    let mut rates: [Vec<f64>; 3] = Default::default();
    let added_growing = rate(first, |routes| Ok(fib.insert_all(routes)?))?;
    let hash_added =
        rate(first, |routes| Ok(routes.iter().try_for_each(|(name, entry)| hash.insert(name, entry, 0))?))?;
    for _ in 0..rounds {
        let [added, changed, removed] = &mut rates;
        changed.push(rate(second, |routes| Ok(fib.insert_all(routes)?))?);
        removed.push(rate(second, |routes| {
            ensure!(routes.iter().all(|(name, _)| fib.remove(name)), "a name was not there");
            Ok(())
        })?);
        added.push(rate(first, |routes| Ok(fib.insert_all(routes)?))?);
    }
    ensure!((0..NAMES.into()).all(|i| fib.get(&lookups::name(i)).is_some_and(|entry| lookups::is_route(i, entry))));
    let lookups = ASKED.iter().map(|asked| lookup_row(&mut asks, *asked, rounds)).collect::<Result<_>>()?;
    let (lookup_idle, lookup_meanwhile) = while_changing(&mut asks, &mut fib, &versions, rounds)?;
    let [added, changed, removed] = rates.map(median);
    Ok(FibFigures {
        names: NAMES,
        bytes_per_name: f64::from(flat::buckets_for(NAMES)) * (flat::BUCKET * 8) as f64 / f64::from(NAMES),
        lookups,
        updates: Updates { added, changed, removed, added_growing, hash_added, lookup_idle, lookup_meanwhile },
    })
}

fn lookup_row(asks: &mut Lookups, asked: u64, rounds: usize) -> Result<LookupRow> {
    let mut costs: [Vec<f64>; 3] = Default::default();
    for _ in 0..rounds {
        for (program, costs) in ["lookup_none", "lookup_flat", "lookup_hash"].into_iter().zip(&mut costs) {
            costs.push(cost(asks, program, asked)?);
        }
    }
    let ratio =
        |over: &[f64]| median(costs[2].iter().zip(&costs[1]).zip(over).map(|((h, f), n)| (h - n) / (f - n)).collect());
    let (times, times_net) = (ratio(&vec![0.0; rounds]), ratio(&costs[0]));
    let [none, flat, hash] = costs.map(median);
    Ok(LookupRow { asked, none, flat, hash, times, times_net })
}

/// What lookups cost with nothing beside, and beside a thread that changes routes.
fn while_changing(
    asks: &mut Lookups,
    fib: &mut Fib,
    versions: &[Vec<(Name, FibEntry)>; 2],
    rounds: usize,
) -> Result<(f64, f64)> {
    let all = u64::from(NAMES);
    let (mut idle, mut meanwhile) = (Vec::new(), Vec::new());
    for _ in 0..rounds {
        idle.push(cost(asks, "lookup_flat", all)?);
        let (changing, over) = (AtomicBool::new(false), AtomicBool::new(false));
        meanwhile.push(std::thread::scope(|scope| {
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
            let cost = cost(asks, "lookup_flat", all);
            over.store(true, Ordering::Relaxed);
            changes.join().expect("no panic")?;
            cost
        })?);
    }
    Ok((median(idle), median(meanwhile)))
}

fn cost(asks: &mut Lookups, program: &str, asked: u64) -> Result<f64> {
    let (cost, found) = asks.run(program, asked, asked, TIMES)?;
    ensure!(found.right == u64::from(TIMES), "{program}, {asked} names: {found:?}");
    Ok(cost)
}

/// Routes per second.
fn rate(routes: &[(Name, FibEntry)], change: impl FnOnce(&[(Name, FibEntry)]) -> Result<()>) -> Result<f64> {
    let start = Instant::now();
    change(routes)?;
    Ok(routes.len() as f64 / start.elapsed().as_secs_f64())
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

impl fmt::Display for FibFigures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "FIB of {} names, {:.0} B each; a lookup in ns:", self.names, self.bytes_per_name)?;
        for LookupRow { asked, none, flat, hash, times, times_net } in &self.lookups {
            write!(f, "{asked:>9} asked for: none {none:.0}, flat {flat:.0}, kernel hash {hash:.0}: ")?;
            writeln!(f, "{times:.1} × ({times_net:.1} × without what both do besides)")?;
        }
        let Updates { added, changed, removed, added_growing, hash_added, lookup_idle, lookup_meanwhile } =
            &self.updates;
        let [added, changed, removed, added_growing, hash_added] =
            [added, changed, removed, added_growing, hash_added].map(|rate| rate / 1e6);
        writeln!(
            f,
            "million names/s: added {added:.1} (with growth {added_growing:.1}), changed {changed:.1}, removed {removed:.1}, kernel hash {hash_added:.1}"
        )?;
        writeln!(f, "a lookup while routes change: {lookup_meanwhile:.0} ns, else {lookup_idle:.0} ns")
    }
}
