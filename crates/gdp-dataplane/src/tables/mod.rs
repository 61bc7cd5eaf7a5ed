//! The full tables of a switch, in this process. One owner changes them; every thread that forwards
//! has a [`TablesReader`] and looks things up while they change, without locks: the userspace plane
//! ([`super::userspace`]) and any other data plane of this process. No sockets, no threads.
//!
//! - Links, next hops and the own bit are a [`Snapshot`]: a change makes another one, which readers
//!   see when they next enter. A link that was removed, and its keys, last until the last reader
//!   has entered again or is gone; so who has nothing to do enters now and then.
//! - [`names`]: where names lead, in a flat table that changes under its readers; when it grows,
//!   the next snapshot has the larger one.
//! - Groups and permits change under their readers too, in the order that the kernel's maps keep:
//!   they come before the entry of a name that says to look for them, and go after it. A reader
//!   that is between the two may miss what has just gone; it finds nothing else in its place.
//!
//! What is changed in one order is seen in it but for this: until a reader enters again, names that
//! have come to lead to a link that is newer than its snapshot lead nowhere.

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

/// A link, and where its frames go.
pub type AddressedLink = (KeyedEntry, LinkAddr);

/// Where a name leads, and its permits.
pub type RouteEntry = (FibEntry, Box<[Permit]>);

/// The tables, for who changes them.
pub struct UserTables {
    names: Names,
    /// Of the names that have any.
    permits: HashMap<Name, Box<[Permit]>>,
    /// The key of each group in [`Common::groups`], by its number.
    groups: HashMap<u32, u32>,
    last_key: u32,
    now: Arc<Snapshot>,
    published: Arc<ArcSwap<Snapshot>>,
    common: Arc<Common>,
}

/// The tables, for one thread that forwards.
#[derive(Clone)]
pub struct TablesReader {
    current: Cache<Arc<ArcSwap<Snapshot>>, Arc<Snapshot>>,
    common: Arc<Common>,
}

/// The tables as a thread sees them that has entered. For a batch of frames: what is removed
/// meanwhile stays in memory.
pub struct View<'r> {
    now: &'r Snapshot,
    common: &'r Common,
    guard: LocalGuard<'r>,
}

/// What does not change: a change makes another one.
#[derive(Clone)]
struct Snapshot {
    links: Box<[Option<Arc<AddressedLink>>]>,
    /// Link ids of neighbouring switches.
    neighbours: Box<[u32]>,
    next_hops: [u32; EGRESS_SET_SIZE as usize],
    own_bit: u64,
    names: NameMemory,
}

/// What changes under its readers. The two maps have one collector, so that a guard is one for
/// both.
struct Common {
    /// By keys that do not return: what a name's entry leads to is never another's. In [`Names`],
    /// they are [`FibEntry::group`].
    groups: papaya::HashMap<u32, Group>,
    permits: papaya::HashSet<Permit>,
    link_memory: LinkMemory,
    queues: Arc<Queues>,
}

struct Group {
    /// By which the control plane knows it.
    number: u32,
    /// Link ids of its local readers.
    readers: Box<[u32]>,
}

impl UserTables {
    /// `limit`: names there may be.
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

    /// For another thread.
    pub fn reader(&self) -> TablesReader {
        TablesReader { current: Cache::new(self.published.clone()), common: self.common.clone() }
    }

    /// Returns the entry that was at this link's index.
    pub fn set_link(&mut self, entry: LinkEntry, to: LinkAddr) -> Option<KeyedEntry> {
        let link = Arc::new((entry.into(), to));
        self.change_link(entry.id, Some(link))
    }

    /// Returns the link, if it was there.
    pub fn remove_link(&mut self, id: u32) -> Option<KeyedEntry> {
        self.now.at_index_of(id).filter(|(entry, _)| entry.id == id)?;
        self.change_link(id, None)
    }

    pub fn link(&self, id: u32) -> Option<&LinkEntry> {
        self.now.link(id)
    }

    /// The link at this link's index.
    pub fn at_index_of(&self, id: u32) -> Option<&LinkEntry> {
        self.now.at_index_of(id).map(|(entry, _)| &**entry)
    }

    pub fn links(&self) -> impl Iterator<Item = &AddressedLink> {
        self.now.links()
    }

    /// Whether a route can be set without there being more than may be.
    pub fn has_room_for(&self, name: &Name) -> bool {
        self.names.has_room_for(name)
    }

    /// Returns the route the name had. `permits`: those of links that may send to it, besides
    /// `entry.writer_link`, and of links by which frames from it may come. The entry's group is one
    /// that was set. If there is no room, nothing is changed; for a route that was there before the
    /// last change of its name, there is.
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
        // It may have grown even if there was no room.
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

    /// Returns the route the name had.
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

    /// In no order.
    pub fn routes(&self) -> impl Iterator<Item = (Name, FibEntry)> {
        self.names.table().iter().map(|(name, entry)| (name, self.numbered(entry)))
    }

    /// Where a name leads, with its permits.
    pub fn route_entry(&self, name: &Name) -> Option<RouteEntry> {
        Some((self.route(name)?, self.permits(name).into()))
    }

    /// The permits of the name.
    pub fn permits(&self, name: &Name) -> &[Permit] {
        self.permits.get(name).map_or(&[], |permits| permits)
    }

    /// The local readers of a group; none: it is free. Before the first route that leads to it, and
    /// after the last.
    pub fn set_group(&mut self, number: u32, readers: &[u32]) {
        let groups = self.common.groups.pin();
        if readers.is_empty() {
            self.groups.remove(&number).iter().for_each(|key| {
                groups.remove(key);
            });
            return;
        }
        let key = *self.groups.entry(number).or_insert_with(|| {
            // Some group may have lasted while all other keys were used.
            loop {
                self.last_key = self.last_key.wrapping_add(1);
                if self.last_key != NEIGHBOURS && !groups.contains_key(&self.last_key) {
                    break self.last_key;
                }
            }
        });
        groups.insert(key, Group { number, readers: readers.into() });
    }

    /// The links of a group.
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

    /// The header of a frame of this node itself as it leaves by a link, and where to.
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

    /// The entry as the control plane knows it.
    fn numbered(&self, entry: FibEntry) -> FibEntry {
        let group = self.common.groups.pin().get(&entry.group).map_or(NEIGHBOURS, |group| group.number);
        FibEntry { group, ..entry }
    }
}

impl TablesReader {
    /// Once for each batch of frames, and now and then while there are none.
    #[inline]
    pub fn enter(&mut self) -> View<'_> {
        View { now: self.current.load(), common: &self.common, guard: self.common.groups.guard() }
    }
}

impl View<'_> {
    /// Where frames go that leave by a link.
    pub fn address(&self, id: u32) -> Option<LinkAddr> {
        self.now.address(id)
    }

    /// The links of a group.
    #[inline]
    pub fn members(&self, group: u32) -> impl Iterator<Item = u32> {
        self.now.members(self.common.groups.get(&group, &self.guard))
    }

    /// The count for the first of so many frames that leave by the link one after the other.
    #[inline]
    pub fn next_counts(&self, id: u32, frames: u64) -> u64 {
        self.common.link_memory.next_counts(id, frames)
    }

    /// Brings what a lookup of the name begins with into the caches, without waiting for it.
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
