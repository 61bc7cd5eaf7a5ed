//! The BPF maps as the tables that the forwarding decision asks.

use gdp_wire::replay::Words;
use gdp_wire::table::Tables;
use gdp_wire::{FibEntry, LinkEntry, Name};

use crate::{config, fib, links, next_hops, permits, windows};

pub struct Maps;

impl Tables for Maps {
    #[inline(always)]
    fn link(&self, id: u32) -> Option<&LinkEntry> {
        links::get(id)
    }

    #[inline(always)]
    fn route(&self, name: &Name) -> Option<FibEntry> {
        fib::route(name)
    }

    #[inline(always)]
    fn next_hop(&self, bit: u32) -> u32 {
        next_hops::next_hop(bit)
    }

    #[inline(always)]
    fn own_bit(&self) -> u64 {
        config::get().own_bit
    }

    #[inline(always)]
    fn is_permitted(&self, link: &LinkEntry, name: &Name) -> bool {
        permits::is_permitted(link, name)
    }

    #[inline(always)]
    fn window(&self, link: &LinkEntry) -> Option<impl Words> {
        windows::get(link)
    }

    #[inline(always)]
    fn next_count(&self, link: &LinkEntry) -> u64 {
        links::next_count(link)
    }
}
