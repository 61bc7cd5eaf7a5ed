//! What the tables of the neighbouring domains hold at most.

/// What is kept of neighbours at most.
#[derive(Clone, Copy, Debug)]
pub struct TierLimits {
    pub children: usize,
    /// Of each neighbour: records, key boxes and locators together.
    pub entries: usize,
    /// Of each neighbour.
    pub bytes: usize,
    /// Of each neighbour: more than anybody here exchanges messages with in one name
    /// (`counterparts` of [`crate::rib::Limits`]), of writers and readers each.
    pub parts_per_name: usize,
}

impl Default for TierLimits {
    fn default() -> Self {
        Self { children: 1024, entries: 1 << 20, bytes: 1 << 30, parts_per_name: 8192 }
    }
}
