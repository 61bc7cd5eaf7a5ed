//! The userspace plane's tables, and what it does with one frame. Pure: no sockets, no threads; [`super::forwarder`] has
//! those. Complete: it is the slow path of XDP and the whole path where XDP does not run.

use std::collections::HashMap;

use gdp::port::LinkAddr;
use gdp_wire::forward::{self, Kind, Plane, Verdict};
use gdp_wire::replay::Words;
use gdp_wire::table::{EGRESS_SET_SIZE, MAX_LINKS, Tables, link_index};
use gdp_wire::{Counter, FibEntry, Header, LinkEntry, Name};
use zerocopy::{FromBytes, IntoBytes};

use super::link_memory::LinkMemory;

/// What becomes of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// It goes there, rewritten in place, and is counted so unless that fails.
    Send {
        link: u32,
        to: LinkAddr,
        counter: Counter,
    },
    /// It is for the control plane.
    Control,
    Drop(Counter),
}

/// The full tables of a switch.
pub struct UserTables {
    links: Vec<Option<(LinkEntry, LinkAddr)>>,
    /// With the links that may send to the name, besides the one in its entry.
    routes: HashMap<Name, (FibEntry, Box<[u32]>)>,
    next_hops: [u32; EGRESS_SET_SIZE as usize],
    own_bit: u64,
    link_memory: LinkMemory,
}

/// Decides about a GDP frame (without what carried it) and rewrites it for its next link.
pub fn handle(frame: &mut [u8], tables: &UserTables) -> Outcome {
    match frame.first().copied().map(forward::classify) {
        Some(Kind::Data) => {}
        Some(Kind::Control) => return Outcome::Control,
        Some(Kind::Unknown) => return Outcome::Drop(Counter::Unknown),
        None => return Outcome::Drop(Counter::Truncated),
    }
    // A copy, because a frame may lie anywhere.
    let Ok((mut header, _)) = Header::read_from_prefix(frame) else { return Outcome::Drop(Counter::Truncated) };
    match forward::decide(&mut header, frame.len(), tables, Plane::Userspace) {
        Verdict::Send(link, counter) => {
            let Some(to) = tables.address(link.id) else { return Outcome::Drop(Counter::NoLink) };
            frame[..Header::LEN].copy_from_slice(header.as_bytes());
            Outcome::Send { link: link.id, to, counter }
        }
        // Only the kernel has someone to leave a frame to.
        Verdict::Slow => Outcome::Drop(Counter::RedirectFailed),
        Verdict::Drop(counter) => Outcome::Drop(counter),
    }
}

impl UserTables {
    pub fn new(link_memory: LinkMemory) -> Self {
        Self {
            links: vec![None; MAX_LINKS as usize],
            routes: HashMap::new(),
            next_hops: [0; EGRESS_SET_SIZE as usize],
            own_bit: 0,
            link_memory,
        }
    }

    /// Returns the entry that was at this link's index.
    pub fn set_link(&mut self, entry: LinkEntry, to: LinkAddr) -> Option<LinkEntry> {
        let before = self.links[link_index(entry.id) as usize].replace((entry, to))?;
        Some(before.0)
    }

    /// Returns the link, if it was there.
    pub fn remove_link(&mut self, id: u32) -> Option<LinkEntry> {
        let slot = &mut self.links[link_index(id) as usize];
        let removed = slot.take_if(|(entry, _)| entry.id == id)?;
        Some(removed.0)
    }

    pub fn links(&self) -> impl Iterator<Item = &(LinkEntry, LinkAddr)> {
        self.links.iter().flatten()
    }

    /// Whether a route can be set without there being more than `capacity`.
    pub fn has_room_for(&self, name: &Name, capacity: usize) -> bool {
        self.routes.len() < capacity || self.routes.contains_key(name)
    }

    /// Returns the route the name had. `permitted`: links that may send to it, besides `entry.writer_link`.
    pub fn set_route(&mut self, name: Name, entry: FibEntry, permitted: &[u32]) -> Option<(FibEntry, Box<[u32]>)> {
        self.routes.insert(name, (entry, permitted.into()))
    }

    /// Returns the route the name had.
    pub fn remove_route(&mut self, name: &Name) -> Option<(FibEntry, Box<[u32]>)> {
        self.routes.remove(name)
    }

    pub fn routes(&self) -> impl Iterator<Item = (&Name, &FibEntry)> {
        self.routes.iter().map(|(name, (entry, _))| (name, entry))
    }

    /// Links that may send to the name, besides the one in its entry.
    pub fn permitted(&self, name: &Name) -> &[u32] {
        self.routes.get(name).map_or(&[], |(_, permitted)| permitted)
    }

    pub fn set_next_hops(&mut self, next_hops: &[u32; EGRESS_SET_SIZE as usize]) {
        self.next_hops = *next_hops;
    }

    pub fn set_own_bit(&mut self, own_bit: u64) {
        self.own_bit = own_bit;
    }

    fn address(&self, id: u32) -> Option<LinkAddr> {
        self.links[link_index(id) as usize].as_ref().map(|(_, to)| *to)
    }
}

impl Tables for UserTables {
    fn link(&self, id: u32) -> Option<&LinkEntry> {
        let (entry, _) = self.links[link_index(id) as usize].as_ref()?;
        (entry.id == id && id != 0).then_some(entry)
    }

    fn route(&self, name: &Name) -> Option<FibEntry> {
        self.routes.get(name).map(|(entry, _)| *entry)
    }

    fn next_hop(&self, bit: u32) -> u32 {
        self.next_hops.get(bit as usize).copied().unwrap_or(0)
    }

    fn own_bit(&self) -> u64 {
        self.own_bit
    }

    fn is_permitted(&self, link: &LinkEntry, name: &Name) -> bool {
        self.permitted(name).contains(&link.id)
    }

    fn window(&self, link: &LinkEntry) -> Option<impl Words> {
        Some(self.link_memory.window(link.id))
    }

    fn next_count(&self, link: &LinkEntry) -> u64 {
        self.link_memory.next_count(link.id)
    }
}
