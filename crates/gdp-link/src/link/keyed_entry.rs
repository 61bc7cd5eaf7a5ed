//! A link's entry in user space.
//!
//! [`LinkEntry`] itself is plain memory, as the kernel's maps require, and does not clear its keys.
//! Nodes and data planes wrap it in [`KeyedEntry`].

use std::fmt;
use std::ops::{Deref, DerefMut};

use gdp_wire::LinkEntry;
use zeroize::Zeroize;

/// A [`LinkEntry`] that clears its keys when it is dropped. Each clone clears its own keys. The
/// `Debug` form omits the keys.
#[derive(Clone, Default, PartialEq, Eq)]
pub struct KeyedEntry(LinkEntry);

impl From<LinkEntry> for KeyedEntry {
    fn from(entry: LinkEntry) -> Self {
        Self(entry)
    }
}

impl Deref for KeyedEntry {
    type Target = LinkEntry;

    fn deref(&self) -> &LinkEntry {
        &self.0
    }
}

impl DerefMut for KeyedEntry {
    fn deref_mut(&mut self) -> &mut LinkEntry {
        &mut self.0
    }
}

impl Zeroize for KeyedEntry {
    fn zeroize(&mut self) {
        self.0.rx_keys.zeroize();
        self.0.tx_keys.zeroize();
    }
}

impl Drop for KeyedEntry {
    fn drop(&mut self) {
        self.zeroize();
    }
}

impl fmt::Debug for KeyedEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

#[cfg(test)]
#[path = "../../tests/unit/link/keyed_entry.rs"]
mod tests;
