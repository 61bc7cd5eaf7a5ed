//! The ids that an entity assigns to its links: a table index in the low bits and random bits above
//! it.
//!
//! An id is never 0. The random bits distinguish frames of an earlier link from those of the link
//! that now uses the same index. The data plane drops frames of the earlier link before it verifies
//! the tag.

use std::sync::Arc;

use gdp_wire::table::MAX_LINKS;
use parking_lot::{Mutex, MutexGuard};

use gdp_core::crypto;

/// All link ids of an entity. Clones share one table.
#[derive(Clone, Default)]
pub struct LinkIds(Arc<Mutex<LinkIdTable>>);

#[derive(Default)]
struct LinkIdTable {
    used: Vec<bool>,
    /// Index at which the next search for a free index starts. A freed index thus rests before it
    /// is used again.
    next: usize,
}

impl LinkIds {
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns a free id, or `None` if there are already [`MAX_LINKS`] links. Dropping the returned
    /// value frees the id. Retain it until no data plane contains the link any more.
    pub fn allocate(&self) -> Option<LinkId> {
        let random = u32::from_ne_bytes(crypto::random::<4>().ok()?);
        let mut table = self.lock();
        table.used.resize(MAX_LINKS as usize, false);
        let index = (0..MAX_LINKS as usize).map(|i| (table.next + i) % MAX_LINKS as usize).find(|i| !table.used[*i])?;
        table.used[index] = true;
        table.next = index + 1;
        let high = (random & !(MAX_LINKS - 1)).max(MAX_LINKS);
        Some(LinkId { id: high | index as u32, ids: self.clone() })
    }

    /// Reserves an id that is already in use, such as one in a data plane from before a restart.
    /// Returns `None` if another link uses its index.
    pub fn reserve(&self, id: u32) -> Option<LinkId> {
        let mut table = self.lock();
        table.used.resize(MAX_LINKS as usize, false);
        let used = &mut table.used[gdp_wire::table::link_index(id) as usize];
        (!std::mem::replace(used, true)).then(|| LinkId { id, ids: self.clone() })
    }

    fn lock(&self) -> MutexGuard<'_, LinkIdTable> {
        self.0.lock()
    }
}

/// An id in use.
pub struct LinkId {
    id: u32,
    ids: LinkIds,
}

impl LinkId {
    pub fn get(&self) -> u32 {
        self.id
    }
}

impl Drop for LinkId {
    fn drop(&mut self) {
        self.ids.lock().used[gdp_wire::table::link_index(self.id) as usize] = false;
    }
}

#[cfg(test)]
#[path = "../../tests/unit/link/ids.rs"]
mod tests;
