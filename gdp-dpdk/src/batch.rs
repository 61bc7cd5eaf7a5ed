//! Tables for the frames of one batch: hop tags are checked and made for all of them together, eight and more at a time, and what this
//! plane cannot do itself is left to the one behind it.

use std::cell::Cell;

use gdp_wire::forward;
use gdp_wire::replay::Words;
use gdp_wire::table::{PORT_ROUTED, Tables};
use gdp_wire::{FibEntry, Header, LinkEntry, LinkRole, Name, Permit};

use crate::carrier::Stations;
use crate::local::{Local, NextHop};
use crate::siphash::siphash24_many;
use crate::view::View;

/// The tables that a batch is decided by.
pub struct BatchTables<'b, V> {
    view: &'b V,
    local: &'b Local,
    ports: &'b [u32],
    /// Of the frame that is being decided about: the key and count that its tag was computed for beforehand, and that tag.
    expected: Cell<([u64; 2], u64, u64)>,
    /// Of the frame that was decided about: the key and count for the tag it is to leave with.
    due: Cell<Option<Due>>,
}

/// What the hop tag of a frame that leaves is made from, beside its header.
#[derive(Clone, Copy)]
pub struct Due {
    pub key: [u64; 2],
    pub count: u64,
}

impl<'b, V: View> BatchTables<'b, V> {
    /// `ports`: those that this plane drives.
    pub fn new(view: &'b V, local: &'b Local, ports: &'b [u32]) -> Self {
        Self { view, local, ports, expected: Cell::new(([0; 2], 0, 0)), due: Cell::new(None) }
    }

    /// The tag that the next frame to be decided about must have.
    pub fn expect(&self, expected: Expected) {
        self.due.set(None);
        self.expected.set((expected.key, expected.count, expected.tag));
    }

    /// What the tag is to be made from of the frame that was decided about or copied last, if it leaves.
    pub fn take_due(&self) -> Option<Due> {
        self.due.take()
    }

    /// The port that the link's frames leave by, and the stations they go between; `None` if they do not leave by this plane.
    pub fn next_hop_of(&self, link: &LinkEntry) -> Option<NextHop> {
        let hop = match link.port {
            PORT_ROUTED => *self.local.next_hops.get(&link.id)?,
            port => NextHop { port, stations: Stations { peer: link.carrier.peer_mac, local: link.carrier.local_mac } },
        };
        self.ports.contains(&hop.port).then_some(hop)
    }
}

/// The hop tag that a frame must have to be authentic, and what it was computed from.
#[derive(Clone, Copy, Default)]
pub struct Expected {
    key: [u64; 2],
    count: u64,
    tag: u64,
}

/// Hop tags of a batch, computed together.
#[derive(Default)]
pub struct Tags {
    keys: Vec<[u64; 2]>,
    words: Vec<[u64; 11]>,
    tags: Vec<u64>,
}

impl Tags {
    /// Computes what the tags of these frames must be. Frames of no link get one that does not matter.
    pub fn expect(&mut self, headers: &[Header], tables: &impl Tables, expected: &mut Vec<Expected>) {
        for header in headers {
            let keyed = tables.link(header.link_id()).and_then(|link| {
                let window = tables.window(link)?;
                Some(forward::keyed(header, link, &window))
            });
            let (key, count) = keyed.unwrap_or_default();
            self.add(header, Due { key, count });
            expected.push(Expected { key, count, tag: 0 });
        }
        self.compute();
        expected.iter_mut().zip(&self.tags).for_each(|(expected, tag)| expected.tag = *tag);
    }

    /// Writes the tags of those headers that leave: their places, and what the tags are made from.
    pub fn write(&mut self, headers: &mut [Header], leaving: impl Iterator<Item = (usize, Due)> + Clone) {
        leaving.clone().for_each(|(place, due)| self.add(&headers[place], due));
        self.compute();
        leaving.zip(&self.tags).for_each(|((place, _), tag)| headers[place].set_tag(*tag));
    }

    fn add(&mut self, header: &Header, Due { key, count }: Due) {
        self.keys.push(key);
        self.words.push(header.tagged_words(count));
    }

    fn compute(&mut self) {
        self.tags.resize(self.keys.len(), 0);
        siphash24_many(&self.keys, &self.words, &mut self.tags);
        self.keys.clear();
        self.words.clear();
    }
}

impl<V: View> Tables for BatchTables<'_, V> {
    const LAST: bool = false;

    #[inline]
    fn link(&self, id: u32) -> Option<&LinkEntry> {
        self.view.tables().link(id)
    }

    #[inline]
    fn route(&self, name: &Name) -> Option<FibEntry> {
        self.view.tables().route(name)
    }

    #[inline]
    fn next_hop(&self, bit: u32) -> u32 {
        self.view.tables().next_hop(bit)
    }

    #[inline]
    fn own_bit(&self) -> u64 {
        self.view.tables().own_bit()
    }

    fn is_permitted(&self, permit: &Permit) -> bool {
        self.view.tables().is_permitted(permit)
    }

    #[inline]
    fn window(&self, link: &LinkEntry) -> Option<impl Words> {
        self.view.tables().window(link)
    }

    #[inline]
    fn next_count(&self, link: &LinkEntry) -> u64 {
        self.view.tables().next_count(link)
    }

    #[inline]
    fn has_tag(&self, header: &Header, key: [u64; 2], count: u64) -> bool {
        let (expected_key, expected_count, tag) = self.expected.get();
        // The window may have moved on since, and the link may have another key.
        let is_known = expected_key == key && expected_count == count;
        header.tag() == if is_known { tag } else { header.tag_for(key, count) }
    }

    #[inline]
    fn write_tag(&self, _: &mut Header, key: [u64; 2], count: u64) {
        self.due.set(Some(Due { key, count }));
    }

    #[inline]
    fn can_send(&self, link: &LinkEntry) -> bool {
        self.next_hop_of(link).is_some()
    }

    fn can_copy(&self, group: u32, bits: u64, _: usize) -> bool {
        let own = self.own_bit();
        let links = self.view.members(group).filter_map(|id| self.view.tables().link(id));
        let wanted =
            |link: &&LinkEntry| bits & if link.role == LinkRole::Switch as u32 { link.reach } else { own } != 0;
        links.filter(wanted).all(|link| self.can_send(link))
    }

    /// A device's queue does not tell.
    #[inline]
    fn has_queue(&self, _: &LinkEntry) -> bool {
        false
    }

    fn may_complain(&self, link: &LinkEntry) -> bool {
        self.view.tables().may_complain(link)
    }

    fn complain(&self, link: &LinkEntry) {
        self.view.tables().complain(link);
    }

    fn may_punt(&self, link: &LinkEntry) -> bool {
        self.view.tables().may_punt(link)
    }

    fn punt(&self, link: &LinkEntry) {
        self.view.tables().punt(link);
    }
}
