//! The userspace plane: the full tables, and a thread for each socket. [`crate::userspace`]
//! processes single frames, and [`crate::forwarder`] has the threads.

use std::collections::HashMap;
use std::io;
use std::sync::Arc;

use gdp_link::port::{DataSocket, LinkAddr};
use gdp_wire::table::EGRESS_SET_SIZE;
use gdp_wire::{Counter, Header, LinkEntry, Name, Permit};

use crate::data_plane::DataPlane;
use crate::forwarder::Forwarder;
use crate::forwarder_state::{Medium, Shared};
use crate::kernel_failures::UpdateError;
use crate::link_memory::LinkMemory;
use crate::tables::{RouteEntry, UserTables};
use crate::tally::LinkCounters;

pub struct UserspacePlane {
    pub tables: UserTables,
    pub shared: Arc<Shared>,
    pub link_memory: LinkMemory,
    forwarders: HashMap<Medium, Forwarder>,
}

impl UserspacePlane {
    /// Creates the plane. `capacity`: maximum number of names.
    pub fn new(link_memory: LinkMemory, capacity: u32) -> Result<Self, UpdateError> {
        let tables = UserTables::new(link_memory.clone(), capacity)?;
        let shared = Arc::new(Shared::new(tables.queues().clone()));
        Ok(Self { tables, shared, link_memory, forwarders: HashMap::new() })
    }

    /// Starts a thread for the socket. `largest`: size in bytes of the largest frame that the
    /// socket can deliver.
    pub fn attach(&mut self, medium: Medium, socket: Arc<DataSocket>, largest: usize) -> io::Result<()> {
        let forwarder = Forwarder::start(medium, socket, largest, &self.shared, self.tables.reader())?;
        self.forwarders.insert(medium, forwarder);
        Ok(())
    }

    /// Stops the thread of a medium and waits until it has ended.
    pub fn detach(&mut self, medium: Medium) {
        self.forwarders.remove(&medium);
    }

    /// Tells all threads to end, so that they end in parallel.
    pub fn stop_threads(&self) {
        self.forwarders.values().for_each(Forwarder::stop);
    }

    /// Lets the threads release the keys of links that were removed or changed.
    fn wake_threads(&self) {
        self.forwarders.values().for_each(Forwarder::wake);
    }

    /// Sends a frame of this node on a link.
    pub fn send_own(&self, link: u32, header: Header, payload: &[u8]) {
        if let Some((header, to)) = self.tables.address_frame(link, header) {
            self.shared.send_own(to, header, payload);
        }
    }
}

impl DataPlane for UserspacePlane {
    fn begin_link(&mut self, id: u32) -> Result<(), UpdateError> {
        self.link_memory.begin(id);
        self.shared.notices.begin(id);
        self.shared.tally.begin(id);
        Ok(())
    }

    fn set_link(&mut self, link: &LinkEntry, to: LinkAddr) -> Result<(), UpdateError> {
        self.tables.set_link(*link, to);
        self.wake_threads();
        Ok(())
    }

    fn remove_link(&mut self, id: u32) -> Result<(), UpdateError> {
        self.tables.remove_link(id);
        self.wake_threads();
        Ok(())
    }

    fn set_route(
        &mut self,
        name: &Name,
        (entry, permits): &RouteEntry,
        _: Option<&RouteEntry>,
    ) -> Result<(), UpdateError> {
        self.tables.set_route(*name, *entry, permits).map(drop)
    }

    fn remove_route(&mut self, name: &Name, _: &[Permit]) -> Result<(), UpdateError> {
        self.tables.remove_route(name);
        Ok(())
    }

    fn set_group(&mut self, group: u32, readers: &[u32], _: Option<&[&LinkEntry]>) {
        self.tables.set_group(group, readers);
    }

    fn release_group(&mut self, group: u32) {
        self.tables.set_group(group, &[]);
    }

    fn set_next_hops(&mut self, next_hops: &[u32; EGRESS_SET_SIZE as usize]) -> Result<(), UpdateError> {
        self.tables.set_next_hops(next_hops);
        Ok(())
    }

    fn set_own_bit(&mut self, own_bit: u64) -> Result<(), UpdateError> {
        self.tables.set_own_bit(own_bit);
        Ok(())
    }

    fn counters(&self) -> Result<[u64; Counter::COUNT], UpdateError> {
        Ok(self.shared.counters())
    }

    fn arrivals(&self, link: u32) -> Result<LinkCounters, UpdateError> {
        Ok(self.shared.tally.of(link))
    }

    fn busiest(&self) -> Result<HashMap<Name, u64>, UpdateError> {
        Ok(self.shared.tally.busiest())
    }
}
