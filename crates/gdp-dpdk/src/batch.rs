//! Tables for the frames of one batch. The expected hop tags of all frames were computed together.
//! Outgoing frames are stamped together later. Frames that this plane cannot process go to the
//! plane behind it.

use std::cell::Cell;

use gdp_wire::replay::Words;
use gdp_wire::table::PORT_ROUTED;
use gdp_wire::tables::Tables;
use gdp_wire::{FibEntry, Header, LinkEntry, LinkRole, Name, Permit, forward};

use crate::carrier::Stations;
use crate::local::Local;
use crate::siphash::Tags;
use crate::view::View;

/// The tables for the decisions on a batch.
pub struct BatchTables<'b, V> {
    view: &'b V,
    local: &'b Local,
    ports: &'b [u32],
    /// The expected hop tags, in the order of the frames.
    arriving: &'b Tags,
    /// Index of the frame that is being decided.
    frame: Cell<usize>,
}

impl<'b, V: View> BatchTables<'b, V> {
    /// Creates the tables. `ports`: the ports that this plane drives.
    pub fn new(view: &'b V, local: &'b Local, ports: &'b [u32], arriving: &'b Tags) -> Self {
        Self { view, local, ports, arriving, frame: Cell::new(0) }
    }

    /// Sets the index of the next frame to decide.
    #[inline]
    pub fn turn_to(&self, frame: usize) {
        self.frame.set(frame);
    }

    /// Returns the egress port of a link and its MAC addresses; `None` if the link does not leave
    /// by this plane.
    #[inline(always)]
    pub fn next_hop_of<'t>(&'t self, link: &'t LinkEntry) -> Option<(u32, Stations<'t>)> {
        let (port, stations) = match link.port {
            PORT_ROUTED => {
                let hop = self.local.next_hops.get(link.id)?;
                (hop.port, hop.stations())
            }
            port => (port, Stations { peer: &link.carrier.peer_mac, local: &link.carrier.local_mac }),
        };
        self.ports.contains(&port).then_some((port, stations))
    }
}

/// Computes the expected hop tags of frames. Frames without a link get an arbitrary tag.
#[inline]
pub fn expect(tags: &mut Tags, headers: &[Header], tables: &impl Tables) {
    tags.clear();
    // Most frames arrive on the link of the preceding frame.
    let (mut last, mut known) = (0, None);
    for (place, header) in (0..).zip(headers) {
        if header.link_id() != last {
            last = header.link_id();
            known = tables.link(last).and_then(|link| Some((link, tables.window(link)?)));
        }
        let keyed = known.as_ref().map(|(link, window)| forward::keyed(header, link, window));
        let (key, count) = keyed.unwrap_or_default();
        tags.add(place, key, count);
    }
    tags.make(headers);
}

impl<V: View> Tables for BatchTables<'_, V> {
    const LAST: bool = false;

    /// Looked up again when frames leave, once for all frames of a link.
    type NextHop = ();

    #[inline(always)]
    fn link(&self, id: u32) -> Option<&LinkEntry> {
        self.view.tables().link(id)
    }

    #[inline(always)]
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

    #[inline(always)]
    fn window(&self, link: &LinkEntry) -> Option<impl Words> {
        self.view.tables().window(link)
    }

    #[inline]
    fn next_count(&self, link: &LinkEntry) -> u64 {
        self.view.tables().next_count(link)
    }

    #[inline(always)]
    fn has_tag(&self, header: &Header, key: [u64; 2], count: u64) -> bool {
        // The window may have moved since, or the link may have another key.
        let made = self.arriving.made_from(self.frame.get(), key, count);
        header.tag() == made.unwrap_or_else(|| header.tag_for(key, count))
    }

    /// Does nothing: all frames that leave by a link are stamped together.
    #[inline(always)]
    fn stamp(&self, _: &mut Header, _: &LinkEntry) {}

    #[inline(always)]
    fn resolve(&self, link: &LinkEntry, _: &mut ()) -> bool {
        self.next_hop_of(link).is_some()
    }

    fn can_copy(&self, group: u32, bits: u64, _: usize) -> bool {
        let own = self.own_bit();
        let links = self.view.members(group).filter_map(|id| self.view.tables().link(id));
        let wanted =
            |link: &&LinkEntry| bits & if link.role == LinkRole::Switch as u32 { link.reach } else { own } != 0;
        links.filter(wanted).all(|link| self.resolve(link, &mut ()))
    }

    /// Returns `false`: a device does not report the length of its queue.
    #[inline]
    fn has_queue(&self, _: &LinkEntry) -> bool {
        false
    }

    fn may_send_error(&self, link: &LinkEntry) -> bool {
        self.view.tables().may_send_error(link)
    }

    fn send_error(&self, link: &LinkEntry) {
        self.view.tables().send_error(link);
    }

    fn may_punt(&self, link: &LinkEntry) -> bool {
        self.view.tables().may_punt(link)
    }

    fn punt(&self, link: &LinkEntry) {
        self.view.tables().punt(link);
    }
}
