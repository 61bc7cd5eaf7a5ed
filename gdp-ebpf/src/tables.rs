//! The BPF maps as the tables of the forwarding decision.

use aya_ebpf::programs::XdpContext;
use gdp_wire::replay::Words;
use gdp_wire::table::{MAX_COPIED_FRAME, PORT_ROUTED, PORT_USERSPACE};
use gdp_wire::tables::Tables;
use gdp_wire::{FibEntry, LinkEntry, Name, Permit};

use crate::next_hop::NextHop;
use crate::{config, fib, groups, links, next_hop, next_hops, permits, verifier, windows};

/// The maps, for the lookups of one frame.
pub struct Maps<'p> {
    pub context: &'p XdpContext,
    /// Bytes of the frame.
    pub length: usize,
    /// A word of the packet. See [`verifier::join`].
    pub unknown: u64,
    /// Whether the packet is in one buffer. The kernel copies no other packets.
    pub in_one_buffer: bool,
}

impl Tables for Maps<'_> {
    /// The userspace plane follows this one.
    const LAST: bool = false;

    #[inline(always)]
    fn joined<V: Copy>(&self, value: V) -> V {
        verifier::join(value, self.unknown)
    }

    type NextHop = NextHop;

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
    fn is_permitted(&self, permit: &Permit) -> bool {
        permits::is_permitted(permit)
    }

    #[inline(always)]
    fn window(&self, link: &LinkEntry) -> Option<impl Words> {
        windows::get(link)
    }

    #[inline(always)]
    fn next_count(&self, link: &LinkEntry) -> u64 {
        links::next_count(link)
    }

    #[inline(always)]
    fn resolve(&self, link: &LinkEntry, hop: &mut NextHop) -> bool {
        match link.port {
            PORT_USERSPACE => false,
            PORT_ROUTED => next_hop::look_up(self.context, link, self.length, hop),
            port => {
                hop.port = port;
                true
            }
        }
    }

    #[inline(always)]
    fn can_copy(&self, group: u32, bits: u64, length: usize) -> bool {
        self.in_one_buffer && length <= MAX_COPIED_FRAME && bits & !groups::served(group) == 0
    }

    /// Redirected frames never wait in a queue of this program: an interface that cannot keep up
    /// drops them.
    #[inline(always)]
    fn has_queue(&self, _: &LinkEntry) -> bool {
        false
    }

    #[inline(always)]
    fn may_send_error(&self, link: &LinkEntry) -> bool {
        links::may_send_error(link)
    }

    #[inline(always)]
    fn send_error(&self, link: &LinkEntry) {
        links::send_error(link);
    }

    #[inline(always)]
    fn may_punt(&self, link: &LinkEntry) -> bool {
        links::may_punt(link)
    }

    /// The userspace plane records the probe, because it passes the probe to the daemon.
    #[inline(always)]
    fn punt(&self, _: &LinkEntry) {}
}
