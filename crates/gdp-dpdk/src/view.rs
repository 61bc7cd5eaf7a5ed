//! Interface between a loop and the tables for its decisions.

use gdp_wire::tables::Tables;
use gdp_wire::{Counter, LinkEntry, Name};

/// The tables of a switch during a batch, and the counters of its frames. Methods must not block or
/// allocate.
pub trait View {
    type Tables: Tables;

    fn tables(&self) -> &Self::Tables;

    /// Returns the link ids of a group.
    fn members(&self, group: u32) -> impl Iterator<Item = u32>;

    /// Reserves sequence numbers for `frames` consecutive frames on the link, and returns the
    /// first: 1 for the link's very first frame.
    fn next_counts(&self, link: &LinkEntry, frames: u64) -> u64;

    /// Prefetches the start of the name's route while the loop processes other frames.
    fn prefetch(&self, name: &Name);

    /// Counts frames that arrived on a link.
    fn count_arrivals(&self, link: u32, counter: Counter, frames: u64);

    /// Counts the name of a sampled outgoing frame ([`gdp_wire::counter::is_sampled`]).
    fn sample(&self, name: &Name);
}

/// Access of one loop to the tables.
pub trait Reader: Send + 'static {
    type View<'a>: View;

    /// Returns the current tables. This is cheap: a loop calls it for every batch.
    fn enter(&mut self) -> Self::View<'_>;
}
