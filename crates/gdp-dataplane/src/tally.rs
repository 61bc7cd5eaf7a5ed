//! Counters of each link's frames and the busiest names, in both planes. [`Tally`] belongs to the
//! userspace plane. [`KernelTally`] reads the maps of `gdp-ebpf/src/tally.rs`, which describe the
//! sampling of names.

use std::collections::{BTreeSet, HashMap};
use std::sync::atomic::{AtomicU64, Ordering};

use aya::maps::{MapData, MapError, PerCpuArray, PerCpuHashMap, PerCpuValues};
use aya::util::nr_cpus;
use gdp_wire::counter::{BUSIEST_NAMES, SAMPLING};
use gdp_wire::table::{MAX_LINKS, link_index};
use gdp_wire::{Counter, Name};
use parking_lot::Mutex;

/// Frames by outcome, in the order of [`Counter::ALL`].
pub type LinkCounters = [u64; Counter::COUNT];

/// Counters written by the threads of the userspace plane.
pub struct Tally {
    links: Box<[[AtomicU64; Counter::COUNT]]>,
    busiest: Mutex<Busiest>,
}

/// Samples of each name, and the names ordered by their samples.
#[derive(Default)]
struct Busiest {
    samples: HashMap<Name, u64>,
    least_first: BTreeSet<(u64, Name)>,
}

impl Default for Tally {
    fn default() -> Self {
        Self {
            links: (0..MAX_LINKS).map(|_| [const { AtomicU64::new(0) }; Counter::COUNT]).collect(),
            busiest: Mutex::default(),
        }
    }
}

impl Tally {
    /// Counts frames that arrived on a link. Frames without a valid link are not counted.
    #[inline]
    pub fn count_arrivals(&self, link: u32, counter: Counter, frames: u64) {
        if !counter.is_before_link() {
            self.links[link_index(link) as usize][counter as usize].fetch_add(frames, Ordering::Relaxed);
        }
    }

    /// Counts the name of a sampled outgoing frame. When there are too many names, a new name
    /// replaces the least busy name and inherits its count. Many idle names therefore cannot
    /// displace a busy name.
    pub fn sample(&self, name: &Name) {
        self.busiest.lock().add(name);
    }

    /// Clears the counters of the link that previously had this index.
    pub fn begin(&self, link: u32) {
        self.links[link_index(link) as usize].iter().for_each(|count| count.store(0, Ordering::Relaxed));
    }

    pub fn of(&self, link: u32) -> LinkCounters {
        let row = &self.links[link_index(link) as usize];
        std::array::from_fn(|i| row[i].load(Ordering::Relaxed))
    }

    /// Returns the approximate number of frames that left for each name.
    pub fn busiest(&self) -> HashMap<Name, u64> {
        let busiest = self.busiest.lock();
        busiest.samples.iter().map(|(name, samples)| (*name, samples * SAMPLING)).collect()
    }
}

impl Busiest {
    fn add(&mut self, name: &Name) {
        let before = match self.samples.get(name) {
            Some(samples) => {
                self.least_first.remove(&(*samples, *name));
                *samples
            }
            None if self.samples.len() < BUSIEST_NAMES as usize => 0,
            None => {
                let least = self.least_first.pop_first();
                least.iter().for_each(|(_, name)| _ = self.samples.remove(name));
                least.map_or(0, |(samples, _)| samples)
            }
        };
        self.samples.insert(*name, before + 1);
        self.least_first.insert((before + 1, *name));
    }
}

/// Counters of the kernel plane.
pub struct KernelTally {
    pub links: PerCpuArray<MapData, LinkCounters>,
    pub busiest: PerCpuHashMap<MapData, Name, u64>,
}

impl KernelTally {
    /// Clears a link's counters, as [`Tally::begin`] does.
    pub fn begin(&mut self, link: u32) -> Result<(), MapError> {
        let cpus = nr_cpus().map_err(|(_, io_error)| MapError::IoError(io_error))?;
        let zeros = PerCpuValues::try_from(vec![[0; Counter::COUNT]; cpus])?;
        self.links.set(link_index(link), zeros, 0)
    }

    /// Returns a link's counters, as [`Tally::of`] does.
    pub fn of(&self, link: u32) -> Result<LinkCounters, MapError> {
        let rows = self.links.get(&link_index(link), 0)?;
        Ok(std::array::from_fn(|i| rows.iter().map(|row| row[i]).sum()))
    }

    /// Returns the busiest names, as [`Tally::busiest`] does.
    pub fn busiest(&self) -> Result<HashMap<Name, u64>, MapError> {
        let mut busiest = HashMap::new();
        for entry in self.busiest.iter() {
            match entry {
                Ok((name, samples)) => _ = busiest.insert(name, samples.iter().sum::<u64>() * SAMPLING),
                // The kernel has evicted this name during the iteration.
                Err(MapError::KeyNotFound | MapError::ElementNotFound) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(busiest)
    }
}

#[cfg(test)]
#[path = "../tests/unit/tally.rs"]
mod tests;
