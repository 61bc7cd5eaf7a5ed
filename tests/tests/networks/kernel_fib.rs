//! The FIB in the kernel during changes: through a mapping, and while the table grows.

use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result, ensure};
use gdp_tests::Tools;
use lookups::{Found, Lookups, is_route, load, name, route};

#[path = "../../benches/forward/lookups.rs"]
mod lookups;

/// Names that the programs look up, and the number of those that are never removed.
const NAMES: u64 = 64;
const KEPT: u64 = 32;

/// The table has as few lines as possible. Every name changes a hundred thousand times a second,
/// and others are inserted and removed in the same lines.
#[test]
fn racing_updates_never_show_a_wrong_route() -> Result<()> {
    const CHANGES: u64 = 5_000_000;
    let (mut lookups, mut fib, _) = load(&bench_object()?, NAMES as u32)?;
    (0..KEPT).try_for_each(|i| fib.insert(&name(i), route(i, 0)))?;
    let found = while_programs_ask(&mut lookups, || {
        let mut random = 1u64;
        for version in 1..=CHANGES {
            random = random.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            let i = (random >> 33) % NAMES;
            if i >= KEPT && random >> 63 == 0 {
                fib.remove(&name(i));
            } else {
                fib.insert(&name(i), route(i, version))?;
            }
        }
        Ok(())
    })?;
    ensure!(found.right > CHANGES / 50 && found.wrong == 0 && found.missed == 0, "{found:?}");
    ensure!((0..KEPT).all(|i| fib.get(&name(i)).is_some_and(|entry| is_route(i, entry))));
    Ok(())
}

#[test]
fn no_name_is_missed_while_the_fib_grows_and_changes() -> Result<()> {
    const MORE: u64 = 200_000;
    let (mut lookups, mut fib, _) = load(&bench_object()?, MORE as u32)?;
    (0..KEPT).try_for_each(|i| fib.insert(&name(i), route(i, 0)))?;
    let found = while_programs_ask(&mut lookups, || {
        for i in NAMES..MORE {
            fib.insert(&name(i), route(i, 0))?;
            fib.insert(&name(i % KEPT), route(i % KEPT, i))?;
        }
        Ok(())
    })?;
    ensure!(found.right > 100_000 && found.wrong == 0 && found.missed == 0, "{found:?}");
    ensure!(fib.iter().count() as u64 == KEPT + MORE - NAMES);
    Ok(())
}

#[test]
fn the_limit_is_kept_and_changes_need_no_room() -> Result<()> {
    let (_, mut fib, _) = load(&bench_object()?, 3000)?;
    let routes: Vec<_> = (0..3000).map(|i| (name(i), route(i, 1))).collect();
    fib.insert_all(&routes)?;
    let refused = fib.insert(&name(3000), route(3000, 1)).err().context("it is full")?.to_string();
    ensure!(refused.contains("the FIB is full (3000 names)") && refused.contains("fib_capacity"), "{refused}");
    let changed: Vec<_> = (0..3000).map(|i| (name(i), route(i, 2))).collect();
    fib.insert_all(&changed)?;
    ensure!((0..3000).all(|i| fib.get(&name(i)) == Some(route(i, 2))));
    ensure!(fib.remove(&name(7)) && !fib.remove(&name(7)));
    fib.insert(&name(3000), route(3000, 1))?;
    ensure!(fib.get(&name(7)).is_none() && fib.iter().count() == 3000);
    Ok(())
}

/// Returns the results of lookups from before `change` until after it.
fn while_programs_ask(lookups: &mut Lookups, change: impl FnOnce() -> Result<()>) -> Result<Found> {
    let (asking, over) = (AtomicBool::new(false), AtomicBool::new(false));
    std::thread::scope(|scope| {
        let asked = scope.spawn(|| {
            let mut all = Found::default();
            while !over.load(Ordering::Relaxed) {
                let found = lookups.run("lookup_flat", NAMES, KEPT, 100_000);
                asking.store(true, Ordering::Relaxed);
                let (_, found) = found?;
                all = Found {
                    right: all.right + found.right,
                    wrong: all.wrong + found.wrong,
                    missed: all.missed + found.missed,
                };
            }
            anyhow::Ok(all)
        });
        while !asking.load(Ordering::Relaxed) {
            std::thread::yield_now();
        }
        let changed = change();
        over.store(true, Ordering::Relaxed);
        let all = asked.join().expect("no panic")?;
        changed.map(|()| all)
    })
}

fn bench_object() -> Result<std::path::PathBuf> {
    Tools::beside_this_test()?.ebpf_bench_object()
}
