//! The interfaces on which GDP runs directly, and the devices that receive their frames.

use std::collections::HashMap;

use gdp_link::port::{Interface, LinkAddr};
use gdp_wire::Vlan;

/// An interface on which GDP runs directly.
pub struct Port {
    pub interface: String,
    /// The device that receives its frames: the interface itself, or the lower interface of a VLAN.
    pub device: u32,
    pub device_name: String,
    vlan: Option<u16>,
}

impl From<&Interface> for Port {
    fn from(interface: &Interface) -> Self {
        let (device, name) = match &interface.vlan {
            Some(vlan) => (vlan.lower_index, &vlan.lower),
            None => (interface.index, &interface.name),
        };
        let vlan = interface.vlan.as_ref().map(|vlan| vlan.id);
        Self { interface: interface.name.clone(), device, device_name: name.clone(), vlan }
    }
}

/// Ports by interface index.
#[derive(Default)]
pub struct Ports(HashMap<u32, Port>);

impl Ports {
    pub fn insert(&mut self, ifindex: u32, port: Port) {
        self.0.insert(ifindex, port);
    }

    pub fn remove(&mut self, ifindex: u32) -> Option<Port> {
        self.0.remove(&ifindex)
    }

    pub fn iter(&self) -> impl Iterator<Item = &Port> {
        self.0.values()
    }

    /// Removes and returns all ports, by interface index.
    pub fn take(&mut self) -> HashMap<u32, Port> {
        std::mem::take(&mut self.0)
    }

    /// Returns the egress device for an Ethernet address. This is the interface itself if GDP does
    /// not run on it. Returns `None` for UDP.
    pub fn device_of(&self, to: LinkAddr) -> Option<u32> {
        match to {
            LinkAddr::Ethernet { ifindex, .. } => Some(self.0.get(&ifindex).map_or(ifindex, |port| port.device)),
            LinkAddr::Udp(_) => None,
        }
    }

    pub fn uses(&self, device: u32) -> bool {
        self.iter().any(|port| port.device == device)
    }

    /// Returns the VLANs among the ports, each with its lower device.
    pub fn vlans(&self) -> Vec<Vlan> {
        self.iter().filter_map(|port| Some(Vlan { ifindex: port.device, id: port.vlan?.into() })).collect()
    }
}
