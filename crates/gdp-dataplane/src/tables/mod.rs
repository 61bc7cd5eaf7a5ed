//! The full tables of a switch, in this process. A single owner changes them. Each forwarding
//! thread has a [`TablesReader`] and looks up entries during changes, without locks. Readers are
//! the userspace plane ([`super::userspace`]) and any other data plane of this process. This module
//! uses no sockets and no threads.
//!
//! - Links, next hops and the own bit form a [`Snapshot`]. A change publishes a new snapshot, which
//!   a reader sees when it next enters. A removed link and its keys stay in memory until every
//!   reader has entered again or been dropped. Idle readers must therefore enter from time to time.
//! - [`names`]: the routes of names, in a flat table that changes under its readers. When the table
//!   grows, the next snapshot has the larger table.
//! - Groups and permits also change under their readers, in the same order as in the kernel's maps.
//!   They are added before the entry of the name that refers to them, and removed after it. A
//!   reader between the two steps may miss a removed group or permit, but never finds a different
//!   one.
//!
//! Readers see changes in the order in which they were made, with one exception. A name can lead to
//! a link that is newer than a reader's snapshot. That reader finds no route for the name until it
//! enters again.

mod names;
pub(crate) mod permits;
#[cfg(test)]
#[path = "../../tests/unit/tables.rs"]
mod tests;

use gdp_wire::hop;
use std::collections::HashMap;
use std::sync::Arc;

use arc_swap::{ArcSwap, Cache};
use gdp_link::link::KeyedEntry;
use gdp_link::port::LinkAddr;
use gdp_wire::replay::Words;
use gdp_wire::table::{EGRESS_SET_SIZE, MAX_LINKS, NEIGHBOURS, link_index};
use gdp_wire::tables::Tables;
use gdp_wire::{FibEntry, Header, LinkEntry, LinkRole, Name, Permit, flat};
use papaya::LocalGuard;

use super::link_memory::LinkMemory;
use super::queues::Queues;
use super::resizable_table::ResizableTable;
use crate::kernel_failures::UpdateError;
use crate::tables::permits::without;
use names::{NameMemory, Names};

/// A link, and the address to which its frames are sent.
pub type AddressedLink = (KeyedEntry, LinkAddr);

/// The FIB entry of a name, and its permits.
pub type RouteEntry = (FibEntry, Box<[Permit]>);

/// The tables, for their only writer.
pub struct UserTables {
    names: Names,
    /// Only names that have permits are present.
    permits: HashMap<Name, Box<[Permit]>>,
    /// The key of each group in [`Common::groups`], by group number.
    groups: HashMap<u32, u32>,
    last_key: u32,
    now: Arc<Snapshot>,
    published: Arc<ArcSwap<Snapshot>>,
    common: Arc<Common>,
}

/// The tables, for one forwarding thread.
#[derive(Clone)]
pub struct TablesReader {
    current: Cache<Arc<ArcSwap<Snapshot>>, Arc<Snapshot>>,
    common: Arc<Common>,
}

/// The tables as a thread sees them after it has entered, for one batch of frames. Entries removed
/// during the batch stay in memory.
pub struct View<'r> {
    now: &'r Snapshot,
    common: &'r Common,
    guard: LocalGuard<'r>,
}

/// Immutable state: each change makes a new snapshot.
#[derive(Clone)]
struct Snapshot {
    links: Box<[Option<Arc<AddressedLink>>]>,
    /// Link ids of neighbouring switches.
    neighbours: Box<[u32]>,
    next_hops: [u32; EGRESS_SET_SIZE as usize],
    own_bit: u64,
    names: NameMemory,
}

/// State that changes under its readers. The two maps share a collector, so that one guard serves
/// both.
struct Common {
    /// Keyed by numbers that are not reused while in use, so that an entry never leads to a
    /// different group. In [`Names`], [`FibEntry::group`] is this key.
    groups: papaya::HashMap<u32, Group>,
    permits: papaya::HashSet<Permit>,
    link_memory: LinkMemory,
    queues: Arc<Queues>,
}

struct Group {
    /// The number that the control plane uses for the group.
    number: u32,
    /// Link ids of the local readers.
    readers: Box<[u32]>,
}

impl UserTables {
    /// Creates empty tables. `limit`: maximum number of names.
    pub fn new(link_memory: LinkMemory, limit: u32) -> Result<Self, UpdateError> {
        let names = Names::new(limit)?;
        let now = Arc::new(Snapshot {
            links: vec![None; MAX_LINKS as usize].into(),
            neighbours: Box::default(),
            next_hops: [0; EGRESS_SET_SIZE as usize],
            own_bit: 0,
            names: names.memory().clone(),
        });
        let collector = Arc::default();
        let common = Common {
            groups: papaya::HashMap::builder().shared_collector(Arc::clone(&collector)).build(),
            permits: papaya::HashSet::builder().shared_collector(collector).build(),
            link_memory,
            queues: Arc::default(),
        };
        Ok(Self {
            names,
            permits: HashMap::new(),
            groups: HashMap::new(),
            last_key: NEIGHBOURS,
            published: Arc::new(ArcSwap::new(now.clone())),
            now,
            common: Arc::new(common),
        })
    }

    /// Returns a reader for another thread.
    pub fn reader(&self) -> TablesReader {
        TablesReader { current: Cache::new(self.published.clone()), common: self.common.clone() }
    }

    /// Adds or replaces a link. Returns the previous entry at this link's index.
    pub fn set_link(&mut self, entry: LinkEntry, to: LinkAddr) -> Option<KeyedEntry> {
        let link = Arc::new((entry.into(), to));
        self.change_link(entry.id, Some(link))
    }

    /// Removes a link and returns it, or `None` if it is not present.
    pub fn remove_link(&mut self, id: u32) -> Option<KeyedEntry> {
        self.now.at_index_of(id).filter(|(entry, _)| entry.id == id)?;
        self.change_link(id, None)
    }

    pub fn link(&self, id: u32) -> Option<&LinkEntry> {
        self.now.link(id)
    }

    /// Returns the link at this link's index, which may have a different id.
    pub fn at_index_of(&self, id: u32) -> Option<&LinkEntry> {
        self.now.at_index_of(id).map(|(entry, _)| &**entry)
    }

    pub fn links(&self) -> impl Iterator<Item = &AddressedLink> {
        self.now.links()
    }

    /// Returns whether a route for this name fits within the limit.
    pub fn has_room_for(&self, name: &Name) -> bool {
        self.names.has_room_for(name)
    }

    /// Sets the route of a name and returns the previous route. `permits` lists links that may send
    /// to the name, besides `entry.writer_link`. It also lists links on which frames from the name
    /// may arrive. The entry's group must have been set. If the table is full, nothing changes.
    /// Restoring the route from before the last change of a name always succeeds.
    pub fn set_route(
        &mut self,
        name: Name,
        entry: FibEntry,
        permits: &[Permit],
    ) -> Result<Option<RouteEntry>, UpdateError> {
        let (before, held) = (self.route(&name), Box::from(self.permits(&name)));
        let (come, gone) = (without(permits, &held), without(&held, permits));
        let group = self.groups.get(&entry.group).copied().unwrap_or(NEIGHBOURS);
        self.permit(come.iter());
        let set = self.names.insert(&name, FibEntry { group, ..entry });
        // The table may have grown even if the insertion failed.
        if !self.names.memory().is(&self.now.names) {
            let names = self.names.memory().clone();
            self.change(|next| next.names = names);
        }
        if let Err(error) = set {
            self.forbid(come.iter());
            return Err(error);
        }
        self.forbid(gone.iter());
        match permits {
            [] => self.permits.remove(&name),
            _ => self.permits.insert(name, permits.into()),
        };
        Ok(before.map(|before| (before, held)))
    }

    /// Removes the route of a name and returns it.
    pub fn remove_route(&mut self, name: &Name) -> Option<RouteEntry> {
        let before = self.route(name)?;
        self.names.remove(name);
        let permits = self.permits.remove(name).unwrap_or_default();
        self.forbid(permits.iter());
        Some((before, permits))
    }

    pub fn route(&self, name: &Name) -> Option<FibEntry> {
        self.names.table().get(name).map(|entry| self.numbered(entry))
    }

    /// Returns all routes, in no particular order.
    pub fn routes(&self) -> impl Iterator<Item = (Name, FibEntry)> {
        self.names.table().iter().map(|(name, entry)| (name, self.numbered(entry)))
    }

    /// Returns the FIB entry of a name, with its permits.
    pub fn route_entry(&self, name: &Name) -> Option<RouteEntry> {
        Some((self.route(name)?, self.permits(name).into()))
    }

    /// Returns the permits of the name.
    pub fn permits(&self, name: &Name) -> &[Permit] {
        self.permits.get(name).map_or(&[], |permits| permits)
    }

    /// Sets the local readers of a group; an empty list frees the group. Call this before the first
    /// route uses the group, and after the last route is removed.
    pub fn set_group(&mut self, number: u32, readers: &[u32]) {
        let groups = self.common.groups.pin();
        if readers.is_empty() {
            self.groups.remove(&number).iter().for_each(|key| {
                groups.remove(key);
            });
            return;
        }
        let key = *self.groups.entry(number).or_insert_with(|| {
            // A long-lived group may still use a key after the counter wraps.
            loop {
                self.last_key = self.last_key.wrapping_add(1);
                if self.last_key != NEIGHBOURS && !groups.contains_key(&self.last_key) {
                    break self.last_key;
                }
            }
        });
        groups.insert(key, Group { number, readers: readers.into() });
    }

    /// Returns the links of a group.
    pub fn members(&self, number: u32) -> Vec<u32> {
        let groups = self.common.groups.pin();
        let group = self.groups.get(&number).and_then(|key| groups.get(key));
        self.now.members(group).collect()
    }

    pub fn set_next_hops(&mut self, next_hops: &[u32; EGRESS_SET_SIZE as usize]) {
        self.change(|next| next.next_hops = *next_hops);
    }

    pub fn next_hop(&self, bit: u32) -> u32 {
        self.now.next_hop(bit)
    }

    pub fn set_own_bit(&mut self, own_bit: u64) {
        self.change(|next| next.own_bit = own_bit);
    }

    /// Returns the header of a frame from this node as it leaves by a link, and the link's address.
    pub fn address_frame(&self, id: u32, mut header: Header) -> Option<(Header, LinkAddr)> {
        let link = self.link(id)?;
        hop::stamp(&mut header, link, self.common.link_memory.next_count(id));
        Some((header, self.now.address(id)?))
    }

    pub fn queues(&self) -> &Arc<Queues> {
        &self.common.queues
    }

    fn change_link(&mut self, id: u32, link: Option<Arc<AddressedLink>>) -> Option<KeyedEntry> {
        let before = self.now.at_index_of(id).map(|(entry, _)| entry.clone());
        self.change(|next| {
            next.links[link_index(id) as usize] = link;
            next.find_neighbours();
        });
        before
    }

    fn change(&mut self, change: impl FnOnce(&mut Snapshot)) {
        let mut next = Snapshot::clone(&self.now);
        change(&mut next);
        self.now = Arc::new(next);
        self.published.store(self.now.clone());
    }

    fn permit<'p>(&self, permits: impl Iterator<Item = &'p Permit>) {
        let held = self.common.permits.pin();
        permits.for_each(|permit| {
            held.insert(*permit);
        });
    }

    fn forbid<'p>(&self, permits: impl Iterator<Item = &'p Permit>) {
        let held = self.common.permits.pin();
        permits.for_each(|permit| {
            held.remove(permit);
        });
    }

    /// Returns the entry with the group number of the control plane.
    fn numbered(&self, entry: FibEntry) -> FibEntry {
        let group = self.common.groups.pin().get(&entry.group).map_or(NEIGHBOURS, |group| group.number);
        FibEntry { group, ..entry }
    }
}

impl TablesReader {
    /// Enters the tables. Readers call this once for each batch, and from time to time while idle.
    #[inline]
    pub fn enter(&mut self) -> View<'_> {
        View { now: self.current.load(), common: &self.common, guard: self.common.groups.guard() }
    }
}

impl View<'_> {
    /// Returns the address to which frames of a link are sent.
    pub fn address(&self, id: u32) -> Option<LinkAddr> {
        self.now.address(id)
    }

    /// Returns the links of a group.
    #[inline]
    pub fn members(&self, group: u32) -> impl Iterator<Item = u32> {
        self.now.members(self.common.groups.get(&group, &self.guard))
    }

    /// Reserves sequence numbers for `frames` consecutive frames on the link, and returns the
    /// first.
    #[inline]
    pub fn next_counts(&self, id: u32, frames: u64) -> u64 {
        self.common.link_memory.next_counts(id, frames)
    }

    /// Prefetches the first cache lines of a lookup of the name.
    #[inline]
    pub fn prefetch(&self, name: &Name) {
        flat::prefetch(self.now.names.as_ref(), name);
    }
}

impl Tables for View<'_> {
    const LAST: bool = true;

    type NextHop = ();

    #[inline(always)]
    fn link(&self, id: u32) -> Option<&LinkEntry> {
        self.now.link(id)
    }

    #[inline(always)]
    fn route(&self, name: &Name) -> Option<FibEntry> {
        flat::lookup(&self.now.names.as_ref(), name)
    }

    #[inline(always)]
    fn next_hop(&self, bit: u32) -> u32 {
        self.now.next_hop(bit)
    }

    #[inline(always)]
    fn own_bit(&self) -> u64 {
        self.now.own_bit
    }

    fn is_permitted(&self, permit: &Permit) -> bool {
        self.common.permits.contains(permit, &self.guard)
    }

    #[inline(always)]
    fn window(&self, link: &LinkEntry) -> Option<impl Words> {
        Some(self.common.link_memory.window(link.id))
    }

    #[inline]
    fn next_count(&self, link: &LinkEntry) -> u64 {
        self.common.link_memory.next_count(link.id)
    }

    fn resolve(&self, _: &LinkEntry, _: &mut ()) -> bool {
        true
    }

    fn can_copy(&self, _: u32, _: u64, _: usize) -> bool {
        true
    }

    fn has_queue(&self, link: &LinkEntry) -> bool {
        self.address(link.id).is_some_and(|to| self.common.queues.is_long_to(to))
    }

    fn may_send_error(&self, link: &LinkEntry) -> bool {
        self.common.link_memory.may_send_error(link.id)
    }

    fn send_error(&self, link: &LinkEntry) {
        self.common.link_memory.send_error(link.id);
    }

    fn may_punt(&self, link: &LinkEntry) -> bool {
        self.common.link_memory.may_punt(link.id)
    }

    fn punt(&self, link: &LinkEntry) {
        self.common.link_memory.punt(link.id);
    }
}

impl Snapshot {
    #[inline]
    fn at_index_of(&self, id: u32) -> Option<&AddressedLink> {
        self.links[link_index(id) as usize].as_deref()
    }

    #[inline]
    fn link(&self, id: u32) -> Option<&LinkEntry> {
        let (entry, _) = self.at_index_of(id)?;
        (entry.id == id && id != 0).then_some(entry)
    }

    fn links(&self) -> impl Iterator<Item = &AddressedLink> {
        self.links.iter().flatten().map(|link| &**link)
    }

    fn address(&self, id: u32) -> Option<LinkAddr> {
        self.at_index_of(id).map(|(_, to)| *to)
    }

    #[inline]
    fn next_hop(&self, bit: u32) -> u32 {
        self.next_hops.get(bit as usize).copied().unwrap_or(0)
    }

    #[inline]
    fn members<'t>(&'t self, group: Option<&'t Group>) -> impl Iterator<Item = u32> + use<'t> {
        group.into_iter().flat_map(|group| &group.readers).chain(&self.neighbours).copied()
    }

    fn find_neighbours(&mut self) {
        let entries = self.links().map(|(entry, _)| entry);
        self.neighbours = entries.filter(|entry| entry.role == LinkRole::Switch as u32).map(|entry| entry.id).collect();
    }
}
