//! Traits of the data planes. [`DataPlane`] covers the state and counters of all three planes.
//! [`FastPath`] covers how XDP and DPDK process frames before the userspace plane. The
//! implementations are [`crate::userspace_plane`], [`crate::xdp`] and [`crate::dpdk`];
//! [`crate::Planes`] calls them.

use std::collections::{HashMap, HashSet};
use std::net::SocketAddr;
use std::time::Duration;

use gdp_link::link::KeyedEntry;
use gdp_link::port::{HostPair, LinkAddr};
use gdp_wire::table::EGRESS_SET_SIZE;
use gdp_wire::{Counter, FibEntry, LinkEntry, Name, Permit, Vlan};

use crate::dpdk::DeviceCounters;
use crate::host_pair::Ends;
use crate::interface_plane::InterfacePlane;
use crate::kernel::Adopted;
use crate::kernel_failures::UpdateError;
use crate::tables::RouteEntry;
use crate::tally::LinkCounters;

/// Forwarding state of a switch. A plane that uses the tables of the userspace plane has no state
/// of its own: the default methods do nothing.
pub trait DataPlane {
    /// Clears the counters of the link that previously had the index of `id`.
    fn begin_link(&mut self, _id: u32) -> Result<(), UpdateError> {
        Ok(())
    }

    /// Adds or replaces a link. Its frames are sent to `to`.
    fn set_link(&mut self, _link: &LinkEntry, _to: LinkAddr) -> Result<(), UpdateError> {
        Ok(())
    }

    fn remove_link(&mut self, _id: u32) -> Result<(), UpdateError> {
        Ok(())
    }

    /// Adds or replaces the route of a name. After an error nothing has changed. `before`: the
    /// previous route.
    fn set_route(&mut self, _: &Name, _: &RouteEntry, _before: Option<&RouteEntry>) -> Result<(), UpdateError> {
        Ok(())
    }

    /// Removes a route. `permits`: the permits of the name. An unknown name is no error.
    fn remove_route(&mut self, _: &Name, _permits: &[Permit]) -> Result<(), UpdateError> {
        Ok(())
    }

    /// Sets the local readers of a group and the links that receive copies. `copies` is `None` if
    /// no frame to the group can need copies.
    fn set_group(&mut self, _group: u32, _readers: &[u32], _copies: Option<&[&LinkEntry]>) {}

    /// Releases a group that no route uses any more.
    fn release_group(&mut self, _group: u32) {}

    /// Sets the link toward each egress switch by its egress bit; 0 for none.
    fn set_next_hops(&mut self, _: &[u32; EGRESS_SET_SIZE as usize]) -> Result<(), UpdateError> {
        Ok(())
    }

    /// Sets this switch's own egress bit, or 0.
    fn set_own_bit(&mut self, _own_bit: u64) -> Result<(), UpdateError> {
        Ok(())
    }

    /// Returns the counters in the order of [`Counter::ALL`].
    fn counters(&self) -> Result<[u64; Counter::COUNT], UpdateError>;

    /// Returns the outcomes of the frames that this plane received on a link.
    fn arrivals(&self, _link: u32) -> Result<LinkCounters, UpdateError> {
        Ok([0; Counter::COUNT])
    }

    /// Returns the approximate number of frames this plane sent for the busiest names.
    fn busiest(&self) -> Result<HashMap<Name, u64>, UpdateError> {
        Ok(HashMap::new())
    }
}

/// A plane that receives frames from devices before the userspace plane. It leaves frames that it
/// cannot process to the userspace plane.
pub trait FastPath: DataPlane + Send {
    /// Returns the name of the plane in the status output.
    fn name(&self) -> &'static str;

    /// Returns whether XDP programs are available, or the reason why not.
    fn xdp(&self) -> Result<(), String>;

    /// Starts to serve a device that the operator named, or returns the reason why not.
    fn attach(&mut self, _device: u32, _name: &str) -> Result<(), String> {
        Ok(())
    }

    /// Stops serving a device that no port uses any more.
    fn detach(&mut self, _device: u32) {}

    /// Serves UDP at `bound` from the next refresh on. `pair`: the host pair for endpoints on this
    /// host.
    fn attach_udp(&mut self, bound: SocketAddr, pair: Option<Ends>) -> Result<(), UpdateError>;

    fn detach_udp(&mut self);

    /// Returns the devices on which this plane receives UDP, with their names.
    fn udp_devices(&self) -> Vec<(u32, String)> {
        Vec::new()
    }

    /// Returns the host pair between this plane and endpoints on this host, if it currently works.
    fn host_pair(&self) -> Option<HostPair> {
        None
    }

    /// Returns which plane serves an interface, and the reason. `device`: the device that receives
    /// its frames.
    fn describe(&self, interface: &str, device: u32) -> InterfacePlane;

    /// Returns, for IPv4 and IPv6, the reason why links over UDP use the userspace plane, if they
    /// do.
    fn udp_in_userspace(&self) -> [Option<String>; 2] {
        [None, None]
    }

    /// Resolves the egress of a link before it is set, if the plane needs that.
    fn resolve(&mut self, _link: &LinkEntry) {}

    /// Returns the port by which this plane can send on a link now. `device`: egress device of an
    /// Ethernet link.
    fn egress_port(&self, link: &LinkEntry, device: Option<u32>) -> Option<u32>;

    /// Resolves the egress of an existing link again. Returns whether it has changed.
    fn follow_route(&mut self, _link: &LinkEntry) -> bool {
        false
    }

    /// Updates addresses, devices and routes of the network namespace. `vlans`: VLANs on which GDP
    /// runs.
    fn begin_refresh(
        &mut self,
        vlans: &[Vlan],
        links: &mut dyn Iterator<Item = &KeyedEntry>,
    ) -> Result<(), UpdateError>;

    /// Ends a refresh: no link uses a port any more that this plane cannot send to.
    fn end_refresh(&mut self) -> Result<(), UpdateError> {
        Ok(())
    }

    /// Returns the subset of these routes that this plane forwards by, with the plane's entries.
    fn read_back(&self, routes: Vec<(Name, FibEntry)>) -> Vec<(Name, FibEntry)> {
        routes
    }

    /// Returns the frames lost after the forwarding decision, by the name of their egress
    /// interface; or the reason why they are unknown.
    fn losses(&self) -> Result<HashMap<String, u64>, String>;

    /// Returns the device counters, by the name of the host's interface.
    fn device_counters(&self) -> HashMap<String, DeviceCounters> {
        HashMap::new()
    }

    /// Returns the processor time that each loop of this plane has used.
    fn processor_time(&self) -> Vec<Duration> {
        Vec::new()
    }

    /// Returns the state that an earlier daemon left in this plane. The plane retains it until
    /// [`Self::end_adoption`].
    fn begin_adoption(&mut self) -> Result<Option<Adopted>, UpdateError> {
        Ok(None)
    }

    /// Removes all permits of an earlier daemon except these.
    fn retain_permits(&mut self, _permits: &HashSet<Permit>) -> Result<(), UpdateError> {
        Ok(())
    }

    /// Removes unclaimed state of an earlier daemon, except links and routes.
    fn end_adoption(&mut self) -> Result<(), UpdateError> {
        Ok(())
    }

    /// Returns whether this plane continues to forward when this process ends.
    fn outlives(&self) -> bool {
        false
    }

    /// Removes all pins, so that all state ends with this plane.
    fn unpin(&mut self) {}
}
