//! What became of the frames of each link, and which names are the busiest, in both planes.
//! [`Tally`] is the userspace plane's own; [`KernelTally`] reads the maps of
//! `gdp-ebpf/src/tally.rs`, which say how names are sampled.

use std::collections::{BTreeSet, HashMap};
use std::sync::atomic::{AtomicU64, Ordering};

use aya::maps::{MapData, MapError, PerCpuArray, PerCpuHashMap, PerCpuValues};
use aya::util::nr_cpus;
use gdp_wire::counter::{BUSIEST_NAMES, SAMPLING};
use gdp_wire::table::{MAX_LINKS, link_index};
use gdp_wire::{Counter, Name};
use parking_lot::Mutex;

/// Frames by what became of them, in the order of [`Counter::ALL`].
pub type LinkCounters = [u64; Counter::COUNT];

/// Written by the threads of the userspace plane.
pub struct Tally {
    links: Box<[[AtomicU64; Counter::COUNT]]>,
    busiest: Mutex<Busiest>,
}

/// Samples of each name, and the names by these.
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
    /// Counts frames that came in on a link. Nothing is counted for ids that no link has.
    #[inline]
    pub fn count_arrivals(&self, link: u32, counter: Counter, frames: u64) {
        if !counter.is_before_link() {
            self.links[link_index(link) as usize][counter as usize].fetch_add(frames, Ordering::Relaxed);
        }
    }

    /// Counts the name of a frame that leaves, of those that are sampled. When there are too many
    /// names, the least busy one makes room, and leaves its count: a name that is busy cannot be
    /// pushed out by many that are not.
    pub fn sample(&self, name: &Name) {
        self.busiest.lock().add(name);
    }

    /// Forgets the link that had the index before.
    pub fn begin(&self, link: u32) {
        self.links[link_index(link) as usize].iter().for_each(|count| count.store(0, Ordering::Relaxed));
    }

    pub fn of(&self, link: u32) -> LinkCounters {
        let row = &self.links[link_index(link) as usize];
        std::array::from_fn(|i| row[i].load(Ordering::Relaxed))
    }

    /// About how many frames left for each name.
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

/// The kernel's.
pub struct KernelTally {
    pub links: PerCpuArray<MapData, LinkCounters>,
    pub busiest: PerCpuHashMap<MapData, Name, u64>,
}

impl KernelTally {
    /// As [`Tally::begin`].
    pub fn begin(&mut self, link: u32) -> Result<(), MapError> {
        let cpus = nr_cpus().map_err(|(_, io_error)| MapError::IoError(io_error))?;
        let zeros = PerCpuValues::try_from(vec![[0; Counter::COUNT]; cpus])?;
        self.links.set(link_index(link), zeros, 0)
    }

    /// As [`Tally::of`].
    pub fn of(&self, link: u32) -> Result<LinkCounters, MapError> {
        let rows = self.links.get(&link_index(link), 0)?;
        Ok(std::array::from_fn(|i| rows.iter().map(|row| row[i]).sum()))
    }

    /// As [`Tally::busiest`].
    pub fn busiest(&self) -> Result<HashMap<Name, u64>, MapError> {
        let mut busiest = HashMap::new();
        for entry in self.busiest.iter() {
            match entry {
                Ok((name, samples)) => _ = busiest.insert(name, samples.iter().sum::<u64>() * SAMPLING),
                // It was pushed out meanwhile.
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
