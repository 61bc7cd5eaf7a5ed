//! The BPF maps as the tables that the forwarding decision asks.

use gdp_wire::table::Tables;
use gdp_wire::{FibEntry, LinkEntry, Name};

use crate::{config, fib, links};

pub struct Maps;

impl Tables for Maps {
    #[inline(always)]
    fn link(&self, id: u32) -> Option<&LinkEntry> {
        links::get(id)
    }

    #[inline(always)]
    fn route(&self, name: &Name) -> Option<&FibEntry> {
        fib::route(name)
    }

    #[inline(always)]
    fn next_hop(&self, bit: u32) -> u32 {
        fib::next_hop(bit)
    }

    #[inline(always)]
    fn own_bit(&self) -> u64 {
        config::get().own_bit
    }

    #[inline(always)]
    fn next_counter(&self, link: &LinkEntry) -> u32 {
        links::next_counter(link)
    }
}
