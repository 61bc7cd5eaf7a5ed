//! Flat tables (`gdp_wire::flat`) that begin small and double when they are full, up to the
//! configured number of names. Readers read the old one until the new one has every name.
//! [`super::fib`] has one for the kernel, [`super::tables`] one for this process.

use std::io;
use std::sync::atomic::AtomicU64;

use gdp_wire::flat::Table;
use gdp_wire::{FibEntry, Name};

use crate::kernel_failures::UpdateError;

/// Names that the first table is for: 128 KiB.
pub const FIRST: u32 = 1024;

/// Names that are copied at a time.
const BATCH: usize = 1024;

/// The only writer of such a table.
pub trait ResizableTable {
    type Memory: AsRef<[AtomicU64]>;

    fn table(&self) -> &Table<Self::Memory>;

    fn table_mut(&mut self) -> &mut Table<Self::Memory>;

    /// Names it may hold; what is there beyond stays.
    fn limit(&self) -> u32;

    /// Has readers read a table for so many names, with all that are in this one. If that fails,
    /// nothing is changed.
    fn grow(&mut self, names: u32) -> Result<(), UpdateError>;

    /// Whether the name can be inserted without there being more than may be.
    fn has_room_for(&self, name: &Name) -> bool {
        self.table().len() < self.limit() || self.table().get(name).is_some()
    }

    /// Adds a name, or changes where it leads. If there is no room, nothing is changed.
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
        // Too many names where this one belongs. That is next to impossible, and elsewhere in
        // another table; but who can bring it about must not make the table grow without end.
        if self.table().capacity() / 2 >= self.limit() {
            return Err(self.full());
        }
        self.grow(self.table().capacity().saturating_mul(2))?;
        self.table_mut().insert(name, entry).map_err(|_| self.full())
    }

    /// Puts all names into a table that nobody reads yet.
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

/// An empty table for so many names, in memory that is zero.
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
