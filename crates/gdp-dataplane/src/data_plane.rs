//! What the data planes have in common: [`DataPlane`] is what all three hold and count,
//! [`FastPath`] how XDP and DPDK take frames before the userspace plane gets them. The
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

/// State of a switch that frames are forwarded by. A plane that decides by the tables of the
/// userspace plane holds none of its own: the defaults do nothing.
pub trait DataPlane {
    /// Forgets what was counted of the link that had the index of `id` before.
    fn begin_link(&mut self, _id: u32) -> Result<(), UpdateError> {
        Ok(())
    }

    /// Adds or replaces a link; frames of it are sent to `to`.
    fn set_link(&mut self, _link: &LinkEntry, _to: LinkAddr) -> Result<(), UpdateError> {
        Ok(())
    }

    fn remove_link(&mut self, _id: u32) -> Result<(), UpdateError> {
        Ok(())
    }

    /// Adds or replaces where a name leads. After an error nothing has changed. `before`: where it
    /// led until now.
    fn set_route(&mut self, _: &Name, _: &RouteEntry, _before: Option<&RouteEntry>) -> Result<(), UpdateError> {
        Ok(())
    }

    /// `permits`: those of the name. An unknown name is no error.
    fn remove_route(&mut self, _: &Name, _permits: &[Permit]) -> Result<(), UpdateError> {
        Ok(())
    }

    /// Sets the local readers of a group and the links that take copies; none, if no frame for it
    /// can need copies.
    fn set_group(&mut self, _group: u32, _readers: &[u32], _copies: Option<&[&LinkEntry]>) {}

    /// No route leads to the group any more.
    fn release_group(&mut self, _group: u32) {}

    /// For each egress bit the link toward that switch, or 0.
    fn set_next_hops(&mut self, _: &[u32; EGRESS_SET_SIZE as usize]) -> Result<(), UpdateError> {
        Ok(())
    }

    /// This switch's own egress bit, or 0.
    fn set_own_bit(&mut self, _own_bit: u64) -> Result<(), UpdateError> {
        Ok(())
    }

    /// In the order of [`Counter::ALL`].
    fn counters(&self) -> Result<[u64; Counter::COUNT], UpdateError>;

    /// What became of the frames that this plane took from a link.
    fn arrivals(&self, _link: u32) -> Result<LinkCounters, UpdateError> {
        Ok([0; Counter::COUNT])
    }

    /// About how many frames this plane sent for the busiest names.
    fn busiest(&self) -> Result<HashMap<Name, u64>, UpdateError> {
        Ok(HashMap::new())
    }
}

/// A plane that takes frames from devices before the userspace plane gets them. It leaves to that
/// what it cannot do.
pub trait FastPath: DataPlane + Send {
    /// As the status shows it.
    fn name(&self) -> &'static str;

    /// Whether there are XDP programs, or why not.
    fn xdp(&self) -> Result<(), String>;

    /// Takes over what arrives on a device that the operator named, or says why it does not.
    fn attach(&mut self, _device: u32, _name: &str) -> Result<(), String> {
        Ok(())
    }

    /// No port uses the device any more.
    fn detach(&mut self, _device: u32) {}

    /// Takes over what arrives over UDP at `bound`, from the next refresh on. `pair`: by which
    /// endpoints on this host are to send.
    fn attach_udp(&mut self, bound: SocketAddr, pair: Option<Ends>) -> Result<(), UpdateError>;

    fn detach_udp(&mut self);

    /// Devices from which this plane takes what arrives over UDP, with their names.
    fn udp_devices(&self) -> Vec<(u32, String)> {
        Vec::new()
    }

    /// The pair by which endpoints on this host reach this plane, and it them, if that works now.
    fn host_pair(&self) -> Option<HostPair> {
        None
    }

    /// Which plane takes what arrives on an interface, and why. `device`: what takes its frames.
    fn describe(&self, interface: &str, device: u32) -> InterfacePlane;

    /// Why links over UDP, of IPv4 and of IPv6, are left to the userspace plane, if they are.
    fn udp_in_userspace(&self) -> [Option<String>; 2] {
        [None, None]
    }

    /// Looks where a link leaves that is about to be set, if that is to be known before.
    fn resolve(&mut self, _link: &LinkEntry) {}

    /// The port by which this plane can send on a link now. `device`: where frames of an Ethernet
    /// link leave.
    fn egress_port(&self, link: &LinkEntry, device: Option<u32>) -> Option<u32>;

    /// Looks where a link that is set leaves; whether that has changed.
    fn follow_route(&mut self, _link: &LinkEntry) -> bool {
        false
    }

    /// Looks again at addresses, devices and routes of the network namespace. `vlans`: those that
    /// GDP runs on.
    fn begin_refresh(
        &mut self,
        vlans: &[Vlan],
        links: &mut dyn Iterator<Item = &KeyedEntry>,
    ) -> Result<(), UpdateError>;

    /// No link leads any more to a port that this plane cannot send to.
    fn end_refresh(&mut self) -> Result<(), UpdateError> {
        Ok(())
    }

    /// Of these routes those that frames are forwarded by, as this plane holds them.
    fn read_back(&self, routes: Vec<(Name, FibEntry)>) -> Vec<(Name, FibEntry)> {
        routes
    }

    /// Frames that were lost after the decision, by the name of the interface they were to leave
    /// by; or why that is not known.
    fn losses(&self) -> Result<HashMap<String, u64>, String>;

    /// What devices have counted, by the name of the interface on the host's side.
    fn device_counters(&self) -> HashMap<String, DeviceCounters> {
        HashMap::new()
    }

    /// Processor time that each loop of this plane has taken.
    fn processor_time(&self) -> Vec<Duration> {
        Vec::new()
    }

    /// What an earlier daemon left in this plane, which keeps it for now.
    fn begin_adoption(&mut self) -> Result<Option<Adopted>, UpdateError> {
        Ok(None)
    }

    /// Takes back every permit that an earlier daemon left but these.
    fn retain_permits(&mut self, _permits: &HashSet<Permit>) -> Result<(), UpdateError> {
        Ok(())
    }

    /// Removes what an earlier daemon left and nobody took over, but for links and routes.
    fn end_adoption(&mut self) -> Result<(), UpdateError> {
        Ok(())
    }

    /// Whether this plane forwards on when this process dies.
    fn outlives(&self) -> bool {
        false
    }

    /// From now on everything ends with this plane.
    fn unpin(&mut self) {}
}
