//! The routes of names, in memory shared by the threads of this process.

use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use gdp_wire::Name;
use gdp_wire::flat::{BUCKET, Table, buckets_for};

use crate::kernel_failures::UpdateError;
use crate::mapping::Mapping;
use crate::{resizable_table, resizable_table::FIRST, resizable_table::ResizableTable};

/// The names, for their only writer.
pub struct Names {
    table: Table<NameMemory>,
    limit: u32,
}

/// A flat table, for its readers. It starts on a page boundary, so no bucket spans two cache lines.
/// Clones share the memory.
#[derive(Clone)]
pub struct NameMemory(Arc<Mapping>);

impl Names {
    /// Creates an empty table. `limit`: maximum number of names.
    pub fn new(limit: u32) -> Result<Self, UpdateError> {
        Ok(Self { table: make(limit.min(FIRST))?, limit })
    }

    /// Returns the current memory for readers. An insertion may replace it.
    pub fn memory(&self) -> &NameMemory {
        self.table.memory()
    }

    pub fn remove(&mut self, name: &Name) {
        self.table.remove(name);
    }
}

impl ResizableTable for Names {
    type Memory = NameMemory;

    fn table(&self) -> &Table<NameMemory> {
        &self.table
    }

    fn table_mut(&mut self) -> &mut Table<NameMemory> {
        &mut self.table
    }

    fn limit(&self) -> u32 {
        self.limit
    }

    fn grow(&mut self, names: u32) -> Result<(), UpdateError> {
        let mut table = make(names)?;
        self.copy_to(&mut table)?;
        self.table = table;
        Ok(())
    }
}

impl NameMemory {
    /// Returns whether both refer to the same memory.
    pub fn is(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

impl AsRef<[AtomicU64]> for NameMemory {
    #[inline]
    fn as_ref(&self) -> &[AtomicU64] {
        (*self.0).as_ref()
    }
}

/// Returns an empty table with room for `names` names.
fn make(names: u32) -> Result<Table<NameMemory>, UpdateError> {
    resizable_table::begin(names, || Ok(NameMemory(Arc::new(Mapping::own(buckets_for(names) as usize * BUCKET)?))))
}
