//! The entry of the node's link, which frames are tagged and checked by. Publishers and the
//! receiving thread read it, batch by batch; the supervisor writes it when keys change. Once a
//! write has returned, every batch that begins meets it.

use std::sync::Arc;

use gdp_wire::LinkEntry;
use parking_lot::{Mutex, MutexGuard};

use gdp_link::link::KeyedEntry;

/// Clones are the same entry.
#[derive(Clone)]
pub struct SharedEntry(Arc<Mutex<KeyedEntry>>);

impl SharedEntry {
    pub fn new(entry: LinkEntry) -> Self {
        Self(Arc::new(Mutex::new(entry.into())))
    }

    pub fn get(&self) -> KeyedEntry {
        self.lock().clone()
    }

    pub fn update(&self, change: impl FnOnce(&mut LinkEntry)) {
        change(&mut self.lock());
    }

    fn lock(&self) -> MutexGuard<'_, KeyedEntry> {
        self.0.lock()
    }
}
