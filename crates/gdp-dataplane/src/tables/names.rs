//! Where names lead, in memory of this process that its threads share.

use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use gdp_wire::Name;
use gdp_wire::flat::{BUCKET, Table, buckets_for};

use crate::kernel_failures::UpdateError;
use crate::mapping::Mapping;
use crate::{resizable_table, resizable_table::FIRST, resizable_table::ResizableTable};

/// The names, for the only one who writes them.
pub struct Names {
    table: Table<NameMemory>,
    limit: u32,
}

/// A flat table, for its readers. It begins with a page, so no line of it is in two cache lines.
/// Clones share it.
#[derive(Clone)]
pub struct NameMemory(Arc<Mapping>);

impl Names {
    /// `limit`: names there may be.
    pub fn new(limit: u32) -> Result<Self, UpdateError> {
        Ok(Self { table: make(limit.min(FIRST))?, limit })
    }

    /// What is to be read, until names are inserted: then it may be another.
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
    /// Whether the two are one.
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

/// An empty table for so many names.
fn make(names: u32) -> Result<Table<NameMemory>, UpdateError> {
    resizable_table::begin(names, || Ok(NameMemory(Arc::new(Mapping::own(buckets_for(names) as usize * BUCKET)?))))
}
