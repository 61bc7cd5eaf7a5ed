//! The FIB in the kernel: the flat table that programs read (`gdp_wire::flat`), written through a
//! mapping, without a system call.
//!
//! It begins small and doubles when it is full, up to the configured number of names. Programs read
//! the old table until the new one has every name, and then the new one: no frame waits or is lost.
//! 128 B a name when a table is full, so 256 B at most, and while it grows half as much again: 64
//! MiB of kernel memory hold 524288 names, 128 MiB 1048576.
//!
//! Where the kernel outlives the daemon, the table is pinned beside the other maps, as `FIB_TABLE`;
//! a larger one that is ready to replace it is for a moment `FIB_TABLE_NEW`. Whichever there is,
//! the next daemon takes the newest, which is complete. Called by [`super::kernel`], by its tests
//! and by `bench forward`.

use std::path::{Path, PathBuf};
use std::{fs, io};

use aya::maps::{Array, ArrayOfMaps, IterableMap, Map, MapData, MapError};
use gdp_wire::flat::{BUCKET, Table, buckets_for, count};
use gdp_wire::{FibEntry, Name};

use super::mapping::Mapping;
use super::pins::{Pins, PinsError};
use super::resizable_table::{self, FIRST, ResizableTable};
use crate::kernel_failures::{LoadError, UpdateError};

// The kernel wants no dots in them.
const PIN: &str = "FIB_TABLE";
const NEW_PIN: &str = "FIB_TABLE_NEW";

// Not in `aya`.
const BPF_F_MMAPABLE: u32 = 1 << 10;
const BPF_F_INNER_MAP: u32 = 1 << 12;

type Buckets = Array<MapData, [u64; BUCKET]>;

/// The map that programs find their table in.
pub type Current = ArrayOfMaps<MapData, Buckets>;

/// The names that the kernel forwards by. The only writer.
pub struct Fib {
    current: Current,
    table: Table<Mapping>,
    limit: u32,
    /// The folder of pins.
    pinned: Option<PathBuf>,
}

impl Fib {
    /// The table that an earlier daemon left, or a new one. `limit`: names it may hold; what is
    /// there beyond stays.
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

    /// All names, in no order.
    pub fn iter(&self) -> impl Iterator<Item = (Name, FibEntry)> {
        self.table.iter()
    }

    /// Adds a name, or changes where it leads. If there is no room, nothing is changed.
    pub fn insert(&mut self, name: &Name, entry: FibEntry) -> Result<(), UpdateError> {
        ResizableTable::insert(self, name, entry)
    }

    /// [`Self::insert`] for many. Those before the one that was refused are in.
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

    /// Whether the name was there.
    pub fn remove(&mut self, name: &Name) -> bool {
        self.table.remove(name)
    }

    /// From now on no table is pinned.
    pub fn unpin(&mut self) {
        self.pinned = None;
    }

    /// Has programs find their table in `map`, and the next daemon as well.
    fn publish(&mut self, map: &Buckets) -> Result<(), UpdateError> {
        self.current.set(0, map, 0).map_err(map_error)?;
        let Some(folder) = &self.pinned else { return Ok(()) };
        let new = folder.join(NEW_PIN);
        match fs::rename(&new, folder.join(PIN)) {
            // It was already there.
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
        // Of the old one nothing is left but what programs still read.
        self.table = table;
        Ok(())
    }
}

/// Names in the table in a folder of pins; a daemon may be at work on it.
pub fn names_pinned(folder: &Path) -> Result<usize, MapError> {
    let Some(pin) = pinned_table(folder) else { return Ok(0) };
    let map = Buckets::try_from(Map::Array(MapData::from_pin(pin)?))?;
    Ok(count(map_memory(&map).map_err(MapError::IoError)?.as_ref()))
}

/// An empty table for so many names, not yet pinned.
fn make(names: u32) -> Result<(Table<Mapping>, Buckets), UpdateError> {
    let map = Buckets::create(buckets_for(names), BPF_F_MMAPABLE | BPF_F_INNER_MAP).map_err(map_error)?;
    let table = resizable_table::begin(names, || map_memory(&map))?;
    Ok((table, map))
}

/// Pins a table that has every name.
fn pin(map: &Buckets, folder: Option<&Path>) -> Result<(), UpdateError> {
    let Some(path) = folder.map(|folder| folder.join(NEW_PIN)) else { return Ok(()) };
    map.map().pin(&path).map_err(|error| UpdateError::FibPin { path, source: io::Error::other(error) })
}

/// What an earlier daemon left, if it did.
fn adopt(folder: &Path) -> Result<Option<(Table<Mapping>, Buckets)>, LoadError> {
    let Some(path) = pinned_table(folder) else { return Ok(None) };
    let broken = |source| PinsError::Map { path: path.clone(), source };
    let map = MapData::from_pin(&path).and_then(|map| Buckets::try_from(Map::Array(map))).map_err(broken)?;
    let memory = map_memory(&map).map_err(|source| PinsError::Io { path: path.clone(), source })?;
    let table = Table::adopt(memory).map_err(|_| PinsError::NotAFib(path.clone()))?;
    Ok(Some((table, map)))
}

/// The newest, which has every name before it is pinned.
fn pinned_table(folder: &Path) -> Option<PathBuf> {
    [NEW_PIN, PIN].map(|name| folder.join(name)).into_iter().find(|path| path.exists())
}

fn map_memory(map: &Buckets) -> io::Result<Mapping> {
    Mapping::new(map.map(), map.len() as usize * BUCKET)
}

fn map_error(source: MapError) -> UpdateError {
    UpdateError::Map { map: "FIB", source }
}
