//! The shared entry of the node's link, for tagging and checking frames.
//!
//! Publishers and the receiving thread read it per batch. The supervisor writes it when keys
//! change. Every batch that starts after a write uses the new keys.

use std::sync::Arc;

use gdp_wire::LinkEntry;
use parking_lot::{Mutex, MutexGuard};

use gdp_link::link::KeyedEntry;

/// The shared entry. Clones refer to the same entry.
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
