//! Flat tables (`gdp_wire::flat`) that start small and double when they are full, up to the
//! configured number of names. Readers use the old table until the new table contains every name.
//! [`super::fib`] has a table for the kernel, [`super::tables`] a table for this process.

use std::io;
use std::sync::atomic::AtomicU64;

use gdp_wire::flat::Table;
use gdp_wire::{FibEntry, Name};

use crate::kernel_failures::UpdateError;

/// Capacity of the first table in names; it uses 128 KiB.
pub const FIRST: u32 = 1024;

/// Number of names copied at a time.
const BATCH: usize = 1024;

/// The only writer of a resizable table.
pub trait ResizableTable {
    type Memory: AsRef<[AtomicU64]>;

    fn table(&self) -> &Table<Self::Memory>;

    fn table_mut(&mut self) -> &mut Table<Self::Memory>;

    /// Returns the maximum number of names. Existing names beyond it remain.
    fn limit(&self) -> u32;

    /// Publishes a table with room for `names` names and all current entries. On an error, nothing
    /// changes.
    fn grow(&mut self, names: u32) -> Result<(), UpdateError>;

    /// Returns whether the name can be inserted within the limit.
    fn has_room_for(&self, name: &Name) -> bool {
        self.table().len() < self.limit() || self.table().get(name).is_some()
    }

    /// Adds a name, or changes its entry. If the table is full, nothing changes.
    fn insert(&mut self, name: &Name, entry: FibEntry) -> Result<(), UpdateError> {
        if self.table().len() >= self.limit().min(self.table().capacity()) && self.table().get(name).is_none() {
            if self.table().len() >= self.limit() {
                return Err(self.full());
            }
            self.grow(self.table().capacity().saturating_mul(2))?;
        }
        if self.table_mut().insert(name, entry).is_ok() {
            return Ok(());
        }
        // The buckets for this name are full. This is very unlikely by chance, and a larger table
        // distributes names differently. The check bounds growth, in case an attacker can cause
        // collisions.
        if self.table().capacity() / 2 >= self.limit() {
            return Err(self.full());
        }
        self.grow(self.table().capacity().saturating_mul(2))?;
        self.table_mut().insert(name, entry).map_err(|_| self.full())
    }

    /// Copies all names into a table that has no readers yet.
    fn copy_to(&self, table: &mut Table<Self::Memory>) -> Result<(), UpdateError> {
        let mut names = self.table().iter();
        let mut batch = Vec::with_capacity(BATCH);
        loop {
            batch.extend(names.by_ref().take(BATCH));
            if batch.is_empty() {
                return Ok(());
            }
            table.insert_all(&batch).map_err(|_| self.full())?;
            batch.clear();
        }
    }

    fn full(&self) -> UpdateError {
        UpdateError::FibFull { capacity: self.limit() }
    }
}

/// Returns an empty table with room for `names` names, in zeroed memory.
pub fn begin<M: AsRef<[AtomicU64]>>(
    names: u32,
    memory: impl FnOnce() -> io::Result<M>,
) -> Result<Table<M>, UpdateError> {
    let no_memory = |source| UpdateError::FibMemory { names, source };
    let random = gdp_core::crypto::random::<16>().map_err(|error| no_memory(io::Error::other(error)))?;
    let (key, _) = random.as_chunks();
    let table = Table::begin(memory().map_err(no_memory)?, [key[0], key[1]].map(u64::from_ne_bytes));
    table.map_err(|error| no_memory(io::Error::other(error)))
}
