//! The userspace plane's tables, and what it does with one frame. Pure: no sockets, no threads; [`super::forwarder`] has
//! those. Complete: it is the slow path of XDP and the whole path where XDP does not run.

use std::collections::HashMap;

use gdp::link::KeyedEntry;
use gdp::port::LinkAddr;
use gdp_wire::forward::{self, Copy, Kind, Verdict};
use gdp_wire::replay::Words;
use gdp_wire::table::{EGRESS_SET_SIZE, MAX_LINKS, Tables, link_index};
use gdp_wire::{Counter, FibEntry, Header, LinkEntry, LinkRole, Name, Permit};
use zerocopy::{FromBytes, IntoBytes};

use super::link_memory::LinkMemory;
use super::queues::Queues;

/// What becomes of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Its first `length` bytes go there, rewritten in place; it is counted so unless that fails.
    Send {
        link: u32,
        to: LinkAddr,
        length: usize,
        counter: Counter,
    },
    /// Copies of it go where [`copies`] says; it is counted as replicated.
    Copies {
        ingress: u32,
        group: u32,
    },
    /// It is for the control plane.
    Control,
    /// It tells this node something: an error, the answer to an echo, or a probe that ends here, from the neighbour on this link.
    Notice {
        link: u32,
        header: Header,
    },
    Drop(Counter),
}

/// A copy of a frame: the header that takes the place of the frame's own, and where that goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CopyOut {
    pub link: u32,
    pub to: LinkAddr,
    pub header: Header,
    pub counter: Counter,
}

/// The full tables of a switch.
pub struct UserTables {
    links: Vec<Option<(KeyedEntry, LinkAddr)>>,
    routes: HashMap<Name, (FibEntry, Box<[Permit]>)>,
    /// Link ids of the local readers of each group.
    groups: HashMap<u32, Box<[u32]>>,
    /// Link ids of neighbouring switches.
    neighbours: Vec<u32>,
    next_hops: [u32; EGRESS_SET_SIZE as usize],
    own_bit: u64,
    link_memory: LinkMemory,
    queues: Queues,
}

/// Decides about a GDP frame (without what carried it) and rewrites it for its next link. `congested`: what carried it was marked.
pub fn handle(frame: &mut [u8], congested: bool, tables: &UserTables) -> Outcome {
    match frame.first().copied().map(forward::classify) {
        Some(Kind::Headed) => {}
        Some(Kind::Control) => return Outcome::Control,
        Some(Kind::Unknown) => return Outcome::Drop(Counter::Unknown),
        None => return Outcome::Drop(Counter::Truncated),
    }
    // A copy, because a frame may lie anywhere.
    let Ok((mut header, _)) = Header::read_from_prefix(frame) else { return Outcome::Drop(Counter::Truncated) };
    let ingress = header.link_id();
    let traffic = if congested { Header::CONGESTED } else { 0 };
    let (link, length, counter) = match forward::decide(&mut header, frame.len(), traffic, tables) {
        Verdict::Send(link, counter) => (link.id, header.frame_len(), counter),
        Verdict::Answer(link, counter) => (link.id, Header::LEN, counter),
        Verdict::Copies(group) => {
            frame[..Header::LEN].copy_from_slice(header.as_bytes());
            return Outcome::Copies { ingress, group };
        }
        Verdict::Notice(link) => return Outcome::Notice { link: link.id, header },
        // Only the kernel has someone to leave a frame to.
        Verdict::Slow => return Outcome::Drop(Counter::RedirectFailed),
        Verdict::Drop(counter) => return Outcome::Drop(counter),
    };
    let Some(to) = tables.address(link) else { return Outcome::Drop(Counter::NoLink) };
    frame[..Header::LEN].copy_from_slice(header.as_bytes());
    Outcome::Send { link, to, length, counter }
}

/// Makes the copies of a frame that [`handle`] wants copied. Calls `send` with each, and `count` with why there is none where
/// there should be.
pub fn copies(
    frame: &[u8],
    (ingress, group): (u32, u32),
    tables: &UserTables,
    mut send: impl FnMut(CopyOut),
    mut count: impl FnMut(Counter),
) {
    let (Some(ingress), Ok((original, _))) = (tables.link(ingress), Header::read_from_prefix(frame)) else { return };
    for id in tables.members(group) {
        let (Some(link), Some(to)) = (tables.link(id), tables.address(id)) else { continue };
        let mut header = original;
        match forward::copy(&mut header, original.frame_len(), link, ingress, tables) {
            Copy::Send(counter) => send(CopyOut { link: id, to, header, counter }),
            Copy::Drop(counter) => count(counter),
            Copy::None => {}
        }
    }
}

impl UserTables {
    pub fn new(link_memory: LinkMemory) -> Self {
        Self {
            links: vec![None; MAX_LINKS as usize],
            routes: HashMap::new(),
            groups: HashMap::new(),
            neighbours: Vec::new(),
            next_hops: [0; EGRESS_SET_SIZE as usize],
            own_bit: 0,
            link_memory,
            queues: Queues::default(),
        }
    }

    /// Returns the entry that was at this link's index.
    pub fn set_link(&mut self, entry: LinkEntry, to: LinkAddr) -> Option<KeyedEntry> {
        let before = self.links[link_index(entry.id) as usize].replace((entry.into(), to));
        self.find_neighbours();
        before.map(|(entry, _)| entry)
    }

    /// Returns the link, if it was there.
    pub fn remove_link(&mut self, id: u32) -> Option<KeyedEntry> {
        let slot = &mut self.links[link_index(id) as usize];
        let removed = slot.take_if(|(entry, _)| entry.id == id)?;
        self.find_neighbours();
        Some(removed.0)
    }

    pub fn links(&self) -> impl Iterator<Item = &(KeyedEntry, LinkAddr)> {
        self.links.iter().flatten()
    }

    /// Whether a route can be set without there being more than `capacity`.
    pub fn has_room_for(&self, name: &Name, capacity: usize) -> bool {
        self.routes.len() < capacity || self.routes.contains_key(name)
    }

    /// Returns the route the name had. `permits`: those of links that may send to it, besides `entry.writer_link`,
    /// and of links by which frames from it may come.
    pub fn set_route(&mut self, name: Name, entry: FibEntry, permits: &[Permit]) -> Option<(FibEntry, Box<[Permit]>)> {
        self.routes.insert(name, (entry, permits.into()))
    }

    /// Returns the route the name had.
    pub fn remove_route(&mut self, name: &Name) -> Option<(FibEntry, Box<[Permit]>)> {
        self.routes.remove(name)
    }

    pub fn routes(&self) -> impl Iterator<Item = (&Name, &FibEntry)> {
        self.routes.iter().map(|(name, (entry, _))| (name, entry))
    }

    /// The permits of the name.
    pub fn permits(&self, name: &Name) -> &[Permit] {
        self.routes.get(name).map_or(&[], |(_, permits)| permits)
    }

    /// The local readers of a group; none: it is free.
    pub fn set_group(&mut self, group: u32, readers: &[u32]) {
        match readers {
            [] => self.groups.remove(&group),
            _ => self.groups.insert(group, readers.into()),
        };
    }

    pub fn set_next_hops(&mut self, next_hops: &[u32; EGRESS_SET_SIZE as usize]) {
        self.next_hops = *next_hops;
    }

    pub fn set_own_bit(&mut self, own_bit: u64) {
        self.own_bit = own_bit;
    }

    /// The header of a frame of this node itself as it leaves by a link, and where to.
    pub fn address_frame(&self, id: u32, mut header: Header) -> Option<(Header, LinkAddr)> {
        let link = self.link(id)?;
        forward::stamp(&mut header, link, self.next_count(link));
        Some((header, self.address(id)?))
    }

    pub fn queues(&self) -> &Queues {
        &self.queues
    }

    fn address(&self, id: u32) -> Option<LinkAddr> {
        self.links[link_index(id) as usize].as_ref().map(|(_, to)| *to)
    }

    /// The links of a group.
    pub fn members(&self, group: u32) -> impl Iterator<Item = u32> {
        self.groups.get(&group).into_iter().flatten().chain(&self.neighbours).copied()
    }

    fn find_neighbours(&mut self) {
        let entries = self.links.iter().flatten().map(|(entry, _)| entry);
        self.neighbours = entries.filter(|entry| entry.role == LinkRole::Switch as u32).map(|entry| entry.id).collect();
    }
}

impl Tables for UserTables {
    const LAST: bool = true;

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

    fn is_permitted(&self, permit: &Permit) -> bool {
        self.permits(&permit.name).contains(permit)
    }

    fn window(&self, link: &LinkEntry) -> Option<impl Words> {
        Some(self.link_memory.window(link.id))
    }

    fn next_count(&self, link: &LinkEntry) -> u64 {
        self.link_memory.next_count(link.id)
    }

    fn can_send(&self, _: &LinkEntry) -> bool {
        true
    }

    fn can_copy(&self, _: u32, _: u64, _: usize) -> bool {
        true
    }

    fn has_queue(&self, link: &LinkEntry) -> bool {
        self.address(link.id).is_some_and(|to| self.queues.is_long_to(to))
    }

    fn may_complain(&self, link: &LinkEntry) -> bool {
        self.link_memory.may_complain(link.id)
    }

    fn complain(&self, link: &LinkEntry) {
        self.link_memory.complain(link.id);
    }

    fn may_punt(&self, link: &LinkEntry) -> bool {
        self.link_memory.may_punt(link.id)
    }

    fn punt(&self, link: &LinkEntry) {
        self.link_memory.punt(link.id);
    }
}
