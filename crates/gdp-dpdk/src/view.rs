//! What a loop is given to decide by.

use gdp_wire::tables::Tables;
use gdp_wire::{Counter, LinkEntry, Name};

/// The tables of a switch as they are during a batch, and where what became of its frames is
/// counted. Nothing may block or allocate.
pub trait View {
    type Tables: Tables;

    fn tables(&self) -> &Self::Tables;

    /// The links of a group, by their ids.
    fn members(&self, group: u32) -> impl Iterator<Item = u32>;

    /// The count for the first of so many frames that leave by the link one after the other: 1 for
    /// its very first.
    fn next_counts(&self, link: &LinkEntry, frames: u64) -> u64;

    /// Has the CPU fetch where the name's route begins, while others are decided about.
    fn prefetch(&self, name: &Name);

    /// Counts frames that came in on a link.
    fn count_arrivals(&self, link: u32, counter: Counter, frames: u64);

    /// Counts the name of a frame that leaves, of those that are sampled
    /// ([`gdp_wire::counter::is_sampled`]).
    fn sample(&self, name: &Name);
}

/// A loop's own way to the tables.
pub trait Reader: Send + 'static {
    type View<'a>: View;

    /// The tables as they are now. Cheap: a loop does so for every batch.
    fn enter(&mut self) -> Self::View<'_>;
}
