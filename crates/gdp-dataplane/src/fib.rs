//! The FIB in the kernel: the flat table that programs read (`gdp_wire::flat`). The daemon writes
//! it through a memory mapping, without system calls.
//!
//! The table starts small and doubles when it is full, up to the configured number of names.
//! Programs read the old table until the new table contains every name, and then the new table. No
//! frame waits or is lost. A full table uses 128 B for each name, so a name uses at most 256 B.
//! Growing temporarily adds half as much again. 64 MiB of kernel memory store 524288 names, and 128
//! MiB store 1048576.
//!
//! Where the kernel state outlives the daemon, the table is pinned beside the other maps as
//! `FIB_TABLE`. While a larger table replaces it, the new table is pinned as `FIB_TABLE_NEW`. The
//! next daemon takes the newest pinned table, which is complete. [`super::kernel`], its tests and
//! `bench forward` call this module.

use std::path::{Path, PathBuf};
use std::{fs, io};

use aya::maps::{Array, ArrayOfMaps, IterableMap, Map, MapData, MapError};
use gdp_wire::flat::{BUCKET, Table, buckets_for, count};
use gdp_wire::{FibEntry, Name};

use super::mapping::Mapping;
use super::pins::{Pins, PinsError};
use super::resizable_table::{self, FIRST, ResizableTable};
use crate::kernel_failures::{LoadError, UpdateError};

// The kernel allows no dots in these names.
const PIN: &str = "FIB_TABLE";
const NEW_PIN: &str = "FIB_TABLE_NEW";

// `aya` does not define these flags.
const BPF_F_MMAPABLE: u32 = 1 << 10;
const BPF_F_INNER_MAP: u32 = 1 << 12;

type Buckets = Array<MapData, [u64; BUCKET]>;

/// The map in which programs find the current table.
pub type Current = ArrayOfMaps<MapData, Buckets>;

/// The names that the kernel forwards by. This is their only writer.
pub struct Fib {
    current: Current,
    table: Table<Mapping>,
    limit: u32,
    /// Folder of the pins.
    pinned: Option<PathBuf>,
}

impl Fib {
    /// Opens the table of an earlier daemon, or creates one. `limit`: maximum number of names.
    /// Existing names beyond the limit remain.
    pub fn open(current: Current, limit: u32, pins: Option<&Pins>) -> Result<Self, LoadError> {
        let pinned = pins.map(|pins| pins.folder().to_owned());
        let left = pinned.as_deref().map_or(Ok(None), adopt)?;
        let (table, map) = match left {
            Some(left) => left,
            None => {
                let (table, map) = make(limit.min(FIRST))?;
                pin(&map, pinned.as_deref())?;
                (table, map)
            }
        };
        let mut fib = Self { current, table, limit, pinned };
        fib.publish(&map)?;
        Ok(fib)
    }

    pub fn get(&self, name: &Name) -> Option<FibEntry> {
        self.table.get(name)
    }

    /// Returns all names, in no particular order.
    pub fn iter(&self) -> impl Iterator<Item = (Name, FibEntry)> {
        self.table.iter()
    }

    /// Adds a name, or changes its entry. If the table is full, nothing changes.
    pub fn insert(&mut self, name: &Name, entry: FibEntry) -> Result<(), UpdateError> {
        ResizableTable::insert(self, name, entry)
    }

    /// Adds many names, as [`Self::insert`] does. On an error, the preceding names remain in the
    /// table.
    pub fn insert_all(&mut self, mut routes: &[(Name, FibEntry)]) -> Result<(), UpdateError> {
        while !routes.is_empty() {
            let room = self.limit.min(self.table.capacity()).saturating_sub(self.table.len()) as usize;
            let (now, later) = routes.split_at(room.clamp(1, routes.len()));
            if room == 0 || self.table.insert_all(now).is_err() {
                now.iter().try_for_each(|(name, entry)| self.insert(name, *entry))?;
            }
            routes = later;
        }
        Ok(())
    }

    /// Removes a name. Returns whether it was present.
    pub fn remove(&mut self, name: &Name) -> bool {
        self.table.remove(name)
    }

    /// Stops pinning tables.
    pub fn unpin(&mut self) {
        self.pinned = None;
    }

    /// Publishes `map` to the programs and to the next daemon.
    fn publish(&mut self, map: &Buckets) -> Result<(), UpdateError> {
        self.current.set(0, map, 0).map_err(map_error)?;
        let Some(folder) = &self.pinned else { return Ok(()) };
        let new = folder.join(NEW_PIN);
        match fs::rename(&new, folder.join(PIN)) {
            // The table was already pinned under its final name.
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            renamed => renamed.map_err(|source| UpdateError::FibPin { path: new, source }),
        }
    }
}

impl ResizableTable for Fib {
    type Memory = Mapping;

    fn table(&self) -> &Table<Mapping> {
        &self.table
    }

    fn table_mut(&mut self) -> &mut Table<Mapping> {
        &mut self.table
    }

    fn limit(&self) -> u32 {
        self.limit
    }

    fn grow(&mut self, names: u32) -> Result<(), UpdateError> {
        let (mut table, map) = make(names)?;
        self.copy_to(&mut table)?;
        pin(&map, self.pinned.as_deref())?;
        self.publish(&map)?;
        // Only programs that are still reading the old table reference it now.
        self.table = table;
        Ok(())
    }
}

/// Returns the number of names in a pinned table, which a daemon may be changing.
pub fn names_pinned(folder: &Path) -> Result<usize, MapError> {
    let Some(pin) = pinned_table(folder) else { return Ok(0) };
    let map = Buckets::try_from(Map::Array(MapData::from_pin(pin)?))?;
    Ok(count(map_memory(&map).map_err(MapError::IoError)?.as_ref()))
}

/// Returns an empty table with room for `names` names, not yet pinned.
fn make(names: u32) -> Result<(Table<Mapping>, Buckets), UpdateError> {
    let map = Buckets::create(buckets_for(names), BPF_F_MMAPABLE | BPF_F_INNER_MAP).map_err(map_error)?;
    let table = resizable_table::begin(names, || map_memory(&map))?;
    Ok((table, map))
}

/// Pins a table that contains every name.
fn pin(map: &Buckets, folder: Option<&Path>) -> Result<(), UpdateError> {
    let Some(path) = folder.map(|folder| folder.join(NEW_PIN)) else { return Ok(()) };
    map.map().pin(&path).map_err(|error| UpdateError::FibPin { path, source: io::Error::other(error) })
}

/// Opens the table of an earlier daemon, if there is one.
fn adopt(folder: &Path) -> Result<Option<(Table<Mapping>, Buckets)>, LoadError> {
    let Some(path) = pinned_table(folder) else { return Ok(None) };
    let broken = |source| PinsError::Map { path: path.clone(), source };
    let map = MapData::from_pin(&path).and_then(|map| Buckets::try_from(Map::Array(map))).map_err(broken)?;
    let memory = map_memory(&map).map_err(|source| PinsError::Io { path: path.clone(), source })?;
    let table = Table::adopt(memory).map_err(|_| PinsError::NotAFib(path.clone()))?;
    Ok(Some((table, map)))
}

/// Returns the newest pinned table. A table is pinned only when it contains every name.
fn pinned_table(folder: &Path) -> Option<PathBuf> {
    [NEW_PIN, PIN].map(|name| folder.join(name)).into_iter().find(|path| path.exists())
}

fn map_memory(map: &Buckets) -> io::Result<Mapping> {
    Mapping::new(map.map(), map.len() as usize * BUCKET)
}

fn map_error(source: MapError) -> UpdateError {
    UpdateError::Map { map: "FIB", source }
}
