//! The lookup programs of `gdp-ebpf/src/bench_lookups.rs` and their tables. `tests/kernel_fib.rs`
//! also includes this file by its path.

use std::path::Path;

use anyhow::{Context, Result};
use aya::maps::{Array, HashMap, MapData};
use aya::programs::{TestRun, TestRunOptions, Xdp};
use aya::{Ebpf, EbpfLoader};
use gdp_dataplane::fib::Fib;
use gdp_wire::{FibEntry, Name, flat};

#[path = "../../../gdp-ebpf/src/bench_names.rs"]
mod bench_names;

/// The kernel's own hash, for comparison.
pub type Hash = HashMap<MapData, Name, FibEntry>;

/// The lookup programs.
pub struct Lookups {
    programs: Ebpf,
    found: Array<MapData, [u64; 3]>,
}

/// Results of lookups.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Found {
    /// Lookups that found a route of the requested name.
    pub right: u64,
    /// Lookups that found another entry.
    pub wrong: u64,
    /// Lookups that found no entry although there is one.
    pub missed: u64,
}

/// Loads the programs and empty tables. `names`: the capacity of each table.
pub fn load(object: &Path, names: u32) -> Result<(Lookups, Fib, Hash)> {
    let mut programs = EbpfLoader::new()
        .map_max_entries("HASH", names)
        .load_file(object)
        .with_context(|| format!("cannot load {}", object.display()))?;
    for name in ["lookup_none", "lookup_flat", "lookup_hash"] {
        let program: &mut Xdp = programs.program_mut(name).with_context(|| format!("no program {name}"))?.try_into()?;
        program.load().with_context(|| format!("cannot load {name}"))?;
    }
    let fib = Fib::open(programs.take_map("FIB").context("no map FIB")?.try_into()?, names, None)?;
    let hash = programs.take_map("HASH").context("no map HASH")?.try_into()?;
    let found = programs.take_map("FOUND").context("no map FOUND")?.try_into()?;
    Ok((Lookups { programs, found }, fib, hash))
}

impl Lookups {
    /// Looks up `times` random names of the first `names`, a power of two. Of these, the first
    /// `stored` must be found. Returns nanoseconds per lookup. They include the cost of making the
    /// name and of a test run.
    pub fn run(&mut self, program: &str, names: u64, stored: u64, times: u32) -> Result<(f64, Found)> {
        let before = self.found()?;
        let mut packet = [0; 128];
        packet[24..32].copy_from_slice(&(names - 1).to_ne_bytes());
        packet[32..40].copy_from_slice(&stored.to_ne_bytes());
        let mut options = TestRunOptions::new();
        options.data_in = Some(&packet);
        options.repeat = times;
        let xdp: &mut Xdp = self.programs.program_mut(program).context("no such program")?.try_into()?;
        let duration = xdp.test_run(options)?.duration;
        let after = self.found()?;
        let found = Found {
            right: after.right - before.right,
            wrong: after.wrong - before.wrong,
            missed: after.missed - before.missed,
        };
        Ok((duration.as_nanos() as f64, found))
    }

    fn found(&self) -> Result<Found> {
        let [right, wrong, missed] = self.found.get(&0, 0)?;
        Ok(Found { right, wrong, missed })
    }
}

pub fn name(number: u64) -> Name {
    let mut bytes = [0; 32];
    for (bytes, word) in bytes.chunks_exact_mut(8).zip(bench_names::name(number)) {
        bytes.copy_from_slice(&word.to_ne_bytes());
    }
    Name::from_bytes(bytes)
}

pub fn route(number: u64, version: u64) -> FibEntry {
    flat::from_words(bench_names::route(number, version))
}

/// Returns whether the entry is a route of this name, in any version.
pub fn is_route(number: u64, entry: FibEntry) -> bool {
    bench_names::is_route(number, flat::to_words(entry))
}
