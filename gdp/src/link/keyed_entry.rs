//! A link's entry for as long as user space holds it: the entry itself is plain memory, as the kernel's maps want it, and does not
//! clear its keys. Nodes and data planes keep it in this.

use std::fmt;
use std::ops::{Deref, DerefMut};

use gdp_wire::LinkEntry;
use zeroize::Zeroize;

/// A [`LinkEntry`] whose keys are cleared when it is dropped, as are those of a clone with the clone. Its `Debug` form leaves
/// them out.
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
mod tests {
    use super::*;
    use std::mem::ManuallyDrop;

    #[test]
    fn its_keys_are_cleared_and_not_printed() {
        let plain = LinkEntry { id: 7, rx_keys: [[0x4242; 2]; 2], tx_keys: [[0x5353; 2]; 2], ..LinkEntry::default() };
        let mut entry = ManuallyDrop::new(KeyedEntry::from(plain));
        let text = format!("{:?} {:#x?}", *entry, *entry);
        assert!(["4242", "5353", "16962", "21331"].iter().all(|secret| !text.contains(secret)), "{text}");
        // SAFETY: dropped once, here; the type owns no memory, so that what is left may be looked at.
        unsafe { ManuallyDrop::drop(&mut entry) };
        assert_eq!((entry.rx_keys, entry.tx_keys, entry.id), ([[0; 2]; 2], [[0; 2]; 2], 7));
    }
}
