//! Limits on the tables of the neighbouring domains.

/// Limits on the state stored for neighbours.
#[derive(Clone, Copy, Debug)]
pub struct TierLimits {
    pub children: usize,
    /// Records, key boxes and locators of each neighbour together.
    pub entries: usize,
    /// Bytes of each neighbour's entries.
    pub bytes: usize,
    /// Writers, and likewise readers, of one name that each neighbour may announce. This exceeds
    /// the number of counterparts of an entity (`counterparts` of [`crate::rib::Limits`]).
    pub parts_per_name: usize,
}

impl Default for TierLimits {
    fn default() -> Self {
        Self { children: 1024, entries: 1 << 20, bytes: 1 << 30, parts_per_name: 8192 }
    }
}
