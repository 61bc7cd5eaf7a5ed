//! The XDP plane: the devices with a program, the devices it may send to, and the links and groups
//! that it may serve. It writes the maps through [`crate::kernel`].

mod attaching;
mod udp_port;

use std::collections::{HashMap, HashSet};
use std::net::SocketAddr;

use gdp_link::link::KeyedEntry;
use gdp_link::port::{HostPair, LinkAddr};
use gdp_wire::table::{EGRESS_SET_SIZE, PORT_ROUTED};
use gdp_wire::{Carrier, Counter, FibEntry, LinkEntry, LinkRole, Name, Permit, SwitchConfig, Vlan};

use self::attaching::{Attacher, OCCUPIED};
use self::udp_port::UdpPort;
use crate::attach_mode::Mode;
use crate::config::{PlaneConfig, PlaneError};
use crate::data_plane::{DataPlane, FastPath};
use crate::group_slots::Member;
use crate::host_pair::Ends;
use crate::interface_plane::InterfacePlane;
use crate::kernel::{Adopted, KernelPlane};
use crate::kernel_failures::{LoadError, UpdateError};
use crate::link_memory::LinkMemory;
use crate::pins::{self, Pins};
use crate::tables::RouteEntry;
use crate::tables::permits::without;
use crate::tally::LinkCounters;
use crate::udp::Routing;
use crate::{capabilities, object};

const NO_REDIRECT: &str = "; frames leave here through the userspace plane, because the interface takes no \
                           redirected frames (a \
                           veth takes them while its peer has an XDP program, or GRO on: `ethtool -K PEER gro on`)";

pub struct XdpPlane {
    kernel: KernelPlane,
    attacher: Attacher,
    config: SwitchConfig,
    /// Interfaces that have or should have a program: those of ports, and those that carry UDP.
    devices: HashMap<u32, XdpDevice>,
    udp: Option<UdpPort>,
    /// Set once links over UDP are used.
    routing: Option<Routing>,
    /// Egress interface of each link over UDP that the kernel can copy frames to.
    routes_of_links: HashMap<u32, u32>,
    /// Ports that no link may use after the current refresh.
    closing: Vec<u32>,
    /// Ports of an earlier daemon that this daemon has not taken over yet. `None`: there were no
    /// ports, or adoption has ended.
    adopted_ports: Option<HashSet<u32>>,
}

/// An interface on which packets arrive and leave.
struct XdpDevice {
    name: String,
    attached: Option<Mode>,
    /// Reason for the chosen plane.
    reason: String,
    /// See [`InterfacePlane::left_alone`].
    left_alone: bool,
    /// Whether a port uses it.
    by_port: bool,
    /// Whether the kernel sends to it. The key in the device map is the interface index.
    sends: bool,
}

impl XdpPlane {
    pub fn load(config: &PlaneConfig) -> Result<Self, LoadError> {
        let missing = capabilities::missing(&capabilities::XDP);
        if !missing.is_empty() {
            return Err(LoadError::NotPermitted(missing));
        }
        let object = object::Object::find(config.ebpf_object.as_deref())?;
        let pins = match &config.pins {
            Some(place) => match Pins::open(place) {
                Err(error) if error.is_bearable() => {
                    tracing::warn!("forwarding ends with this daemon: {error}");
                    None
                }
                pins => Some(pins?),
            },
            None => None,
        };
        let mut kernel = KernelPlane::load_pinned(object, config.fib_capacity, pins)?;
        if !config.count_losses {
            kernel.forgo_losses();
        }
        Ok(Self {
            kernel,
            attacher: Attacher::default(),
            config: SwitchConfig { own_bit: 0, ethertype: config.ethertype.into(), host_pair: 0 },
            devices: HashMap::new(),
            udp: None,
            routing: None,
            routes_of_links: HashMap::new(),
            closing: Vec::new(),
            adopted_ports: None,
        })
    }

    pub fn link_memory(&self) -> &LinkMemory {
        self.kernel.link_memory()
    }

    /// Returns whether the kernel sends to an interface.
    fn sends_to(&self, ifindex: u32) -> bool {
        match self.devices.get(&ifindex) {
            Some(device) => device.sends,
            // A port of an earlier daemon that has not been taken over yet also counts.
            None => self.adopted_ports.as_ref().is_some_and(|ports| ports.contains(&ifindex)),
        }
    }

    /// Returns whether the kernel can route datagrams for this carrier.
    fn routes(&self, carrier: &Carrier) -> bool {
        let Some(routing) = &self.routing else { return false };
        let routes = match carrier.kind {
            Carrier::UDP4 => routing.v4.is_ok(),
            Carrier::UDP6 => routing.v6.is_ok() && carrier.flags & Carrier::ZERO_CHECKSUM != 0,
            _ => false,
        };
        routes && carrier.local_ip != [0; 4]
    }

    /// Returns the egress interface of the kernel's copies for a link, if the kernel can send them.
    fn egress_interface(&self, link: &LinkEntry) -> Option<u32> {
        let interface = match link.port {
            PORT_ROUTED => *self.routes_of_links.get(&link.id)?,
            port => port,
        };
        self.sends_to(interface).then_some(interface)
    }

    fn can_send_to(&self, ifindex: u32) -> bool {
        // Generic XDP redirects ordinary packets, which every interface accepts.
        let only_generic = self.devices.values().all(|device| device.attached != Some(Mode::Native));
        only_generic || self.attacher.takes_redirects(ifindex).unwrap_or(true)
    }

    /// Attaches the program to an interface, unless it is already attached. `named`: attach
    /// regardless of disturbance, if necessary in generic mode.
    fn use_device(&mut self, ifindex: u32, name: &str, named: bool) {
        let by_port = named || self.devices.get(&ifindex).is_some_and(|device| device.by_port);
        if let Some(device) = self.devices.get_mut(&ifindex).filter(|device| device.attached.is_some()) {
            device.by_port = by_port;
            return;
        }
        let (attached, reason) = self.attacher.attach(&mut self.kernel, ifindex, name, named);
        // If another program occupies the interface, naming the interface changes nothing.
        let left_alone = attached.is_none() && !named && !reason.starts_with(OCCUPIED);
        let device = XdpDevice { name: name.to_owned(), attached, reason, left_alone, by_port, sends: false };
        self.devices.insert(ifindex, device);
    }

    /// Detaches the program from an interface that has no remaining users.
    fn leave_device(&mut self, ifindex: u32) {
        let by_udp = self.udp.as_ref().is_some_and(|udp| udp.devices.contains(&ifindex));
        if by_udp || self.devices.get(&ifindex).is_none_or(|device| device.by_port) {
            return;
        }
        let Some(device) = self.devices.remove(&ifindex) else { return };
        if let Err(error) = self.kernel.programs.detach(ifindex) {
            // This happens, for example, when the interface has been deleted.
            tracing::debug!(interface = device.name, %error, "the XDP program was already gone");
        }
        if device.sends {
            let _ = self.kernel.clear_port(ifindex);
        }
        if let Some(ports) = &mut self.adopted_ports {
            ports.remove(&ifindex);
        }
    }

    /// Updates the addresses and interfaces on which the kernel accepts UDP, to match the UDP
    /// socket.
    fn follow_udp(&mut self) -> Result<(), UpdateError> {
        let Some(udp) = &mut self.udp else {
            // During adoption, the kernel continues to accept UDP at the addresses of the earlier
            // daemon.
            return match self.adopted_ports {
                None => self.kernel.set_addresses(&HashSet::new()),
                Some(_) => Ok(()),
            };
        };
        let taken = udp.taken();
        // The ready line names the devices of the first reading, unless it failed.
        let logs = std::mem::replace(&mut udp.logs, true);
        let Some((addresses, found)) = taken else { return Ok(()) };
        self.routing.get_or_insert_with(Routing::enable);
        self.kernel.set_addresses(&addresses)?;
        let before = std::mem::replace(&mut udp.devices, found.keys().copied().collect());
        for (ifindex, name) in found.iter().filter(|(ifindex, _)| !before.contains(ifindex)) {
            let is_new = !self.devices.contains_key(ifindex);
            self.use_device(*ifindex, name, false);
            if logs && is_new {
                self.describe(name, *ifindex).log();
            }
        }
        before
            .into_iter()
            .filter(|ifindex| !found.contains_key(ifindex))
            .for_each(|ifindex| self.leave_device(ifindex));
        Ok(())
    }

    /// Makes an interface a port of the kernel. The userspace plane sends frames that the kernel
    /// cannot send there, also while the interface is being removed.
    fn make_port(&mut self, ifindex: u32) -> Result<(), UpdateError> {
        let sends = match self.kernel.set_port(ifindex, ifindex) {
            Err(UpdateError::PortsFull | UpdateError::Port { .. }) => false,
            result => result.map(|()| true)?,
        };
        self.devices.get_mut(&ifindex).into_iter().for_each(|device| device.sends = sends);
        Ok(())
    }
}

impl DataPlane for XdpPlane {
    fn begin_link(&mut self, id: u32) -> Result<(), UpdateError> {
        self.kernel.begin_link(id)
    }

    fn set_link(&mut self, link: &LinkEntry, _: LinkAddr) -> Result<(), UpdateError> {
        self.kernel.set_link(link)
    }

    fn remove_link(&mut self, id: u32) -> Result<(), UpdateError> {
        self.routes_of_links.remove(&id);
        self.kernel.remove_link(id)
    }

    /// Adds permits before the entry that refers to them, and removes them after it.
    fn set_route(
        &mut self,
        name: &Name,
        (entry, permits): &RouteEntry,
        before: Option<&RouteEntry>,
    ) -> Result<(), UpdateError> {
        let before = before.map_or(&[][..], |(_, permits)| permits);
        let (added, removed) = (without(permits, before), without(before, permits));
        let set = added.iter().try_for_each(|permit| self.kernel.permit(permit));
        match set.and_then(|()| self.kernel.set_route(name, *entry)) {
            Ok(()) => removed.iter().try_for_each(|permit| self.kernel.forbid(permit)),
            Err(error) => {
                let undone = added.iter().try_for_each(|permit| self.kernel.forbid(permit));
                Err(undone.err().unwrap_or(error))
            }
        }
    }

    fn remove_route(&mut self, name: &Name, permits: &[Permit]) -> Result<(), UpdateError> {
        self.kernel.remove_route(name);
        permits.iter().try_for_each(|permit| self.kernel.forbid(permit))
    }

    /// The userspace plane sends copies that the kernel cannot send.
    fn set_group(&mut self, group: u32, _: &[u32], copies: Option<&[&LinkEntry]>) {
        let mut members = Vec::new();
        let mut served = if self.kernel.programs.has_generic() || copies.is_none() { 0 } else { u64::MAX };
        for link in copies.unwrap_or_default() {
            match self.egress_interface(link) {
                Some(interface) => members.push(Member { link: link.id, interface }),
                None if link.role == LinkRole::Switch as u32 => served &= !link.reach,
                None => served &= !self.config.own_bit,
            }
        }
        if let Err(error) = self.kernel.set_group(group, &members, served) {
            tracing::warn!(group, %error, "the userspace plane copies the frames for a group of links");
        }
    }

    fn release_group(&mut self, group: u32) {
        self.kernel.release_group(group);
    }

    fn set_next_hops(&mut self, next_hops: &[u32; EGRESS_SET_SIZE as usize]) -> Result<(), UpdateError> {
        self.kernel.set_next_hops(next_hops)
    }

    fn set_own_bit(&mut self, own_bit: u64) -> Result<(), UpdateError> {
        self.config.own_bit = own_bit;
        self.kernel.set_config(self.config)
    }

    fn counters(&self) -> Result<[u64; Counter::COUNT], UpdateError> {
        self.kernel.counters()
    }

    fn arrivals(&self, link: u32) -> Result<LinkCounters, UpdateError> {
        self.kernel.tally().of(link).map_err(|source| UpdateError::Map { map: "LINK_COUNTERS", source })
    }

    fn busiest(&self) -> Result<HashMap<Name, u64>, UpdateError> {
        self.kernel.tally().busiest().map_err(|source| UpdateError::Map { map: "BUSIEST", source })
    }
}

impl FastPath for XdpPlane {
    fn name(&self) -> &'static str {
        "kernel"
    }

    fn xdp(&self) -> Result<(), String> {
        Ok(())
    }

    fn attach(&mut self, device: u32, name: &str) -> Result<(), String> {
        self.use_device(device, name, true);
        let used = &self.devices[&device];
        used.attached.map(drop).ok_or_else(|| used.reason.clone())
    }

    fn detach(&mut self, device: u32) {
        self.devices.get_mut(&device).into_iter().for_each(|device| device.by_port = false);
        self.leave_device(device);
    }

    /// Accepts UDP in the kernel on Ethernet interfaces with a bound address. The interface must
    /// run native XDP without a [`crate::disturbance`]. Generic XDP would slow down all traffic
    /// that the host receives there.
    fn attach_udp(&mut self, bound: SocketAddr, pair: Option<Ends>) -> Result<(), UpdateError> {
        self.config.host_pair = pair.as_ref().map_or(0, |pair| pair.switch.index);
        self.udp = Some(UdpPort::new(bound, pair));
        self.kernel.set_config(self.config)
    }

    fn detach_udp(&mut self) {
        let Some(udp) = self.udp.take() else { return };
        udp.devices.into_iter().for_each(|device| self.leave_device(device));
    }

    fn udp_devices(&self) -> Vec<(u32, String)> {
        let devices = self.udp.iter().flat_map(|udp| &udp.devices);
        devices.filter_map(|device| Some((*device, self.devices.get(device)?.name.clone()))).collect()
    }

    fn host_pair(&self) -> Option<HostPair> {
        let pair = self.udp.as_ref()?.pair.as_ref()?;
        let works =
            self.devices.get(&pair.switch.index).is_some_and(|device| device.attached.is_some() && device.sends);
        works.then_some(pair.addresses)
    }

    fn describe(&self, interface: &str, device: u32) -> InterfacePlane {
        let found = self.devices.get(&device);
        let attached = found.and_then(|device| device.attached);
        let kind = match attached {
            Some(Mode::Native) => "xdp-native",
            Some(Mode::Generic) => "xdp-generic",
            None => "userspace",
        };
        let redirects = attached.is_none() || self.can_send_to(device);
        let (reason, left_alone) = found.map_or(("", false), |device| (device.reason.as_str(), device.left_alone));
        let reason = reason.to_owned() + if redirects { "" } else { NO_REDIRECT };
        InterfacePlane { interface: interface.to_owned(), kind, reason, left_alone }
    }

    fn udp_in_userspace(&self) -> [Option<String>; 2] {
        let Some(routing) = &self.routing else { return [None, None] };
        [routing.v4.clone().err(), routing.v6.clone().err()]
    }

    fn egress_port(&self, link: &LinkEntry, device: Option<u32>) -> Option<u32> {
        let (port, sends) = match device {
            Some(device) => (device, self.sends_to(device)),
            // An endpoint on this host is reached through the host pair.
            None if link.carrier.local_mac != [0; 3] => (self.config.host_pair, self.sends_to(self.config.host_pair)),
            None => (PORT_ROUTED, self.routes(&link.carrier)),
        };
        sends.then_some(port)
    }

    fn follow_route(&mut self, link: &LinkEntry) -> bool {
        let found = if link.port == PORT_ROUTED {
            self.routing.get_or_insert_with(Routing::enable);
            self.kernel.programs.route_of(link.id)
        } else {
            Ok(None)
        };
        let found = found.unwrap_or_else(|error| {
            tracing::warn!(%error, "the userspace plane copies the frames for links over UDP");
            None
        });
        let before = match found {
            Some(interface) => self.routes_of_links.insert(link.id, interface),
            None => self.routes_of_links.remove(&link.id),
        };
        before != found
    }

    /// Checks again which interfaces accept redirected frames. For a veth this depends on its peer.
    fn begin_refresh(&mut self, vlans: &[Vlan], _: &mut dyn Iterator<Item = &KeyedEntry>) -> Result<(), UpdateError> {
        self.follow_udp()?;
        // During adoption, the kernel continues to accept the VLANs of the earlier daemon.
        if self.adopted_ports.is_none() {
            self.kernel.set_vlans(&vlans.iter().copied().collect())?;
        }
        let (can, cannot): (Vec<u32>, Vec<u32>) =
            self.devices.keys().copied().partition(|ifindex| self.can_send_to(*ifindex));
        for ifindex in can {
            if !self.devices[&ifindex].sends {
                self.make_port(ifindex)?;
            }
        }
        self.closing = cannot;
        self.closing.retain(|ifindex| {
            self.devices.get_mut(ifindex).is_some_and(|device| std::mem::replace(&mut device.sends, false))
        });
        Ok(())
    }

    fn end_refresh(&mut self) -> Result<(), UpdateError> {
        self.closing.drain(..).try_for_each(|ifindex| self.kernel.clear_port(ifindex))
    }

    /// Reads the routes back from the kernel if it forwards.
    fn read_back(&self, routes: Vec<(Name, FibEntry)>) -> Vec<(Name, FibEntry)> {
        if self.devices.values().all(|device| device.attached.is_none()) {
            return routes;
        }
        routes.into_iter().filter_map(|(name, _)| Some((name, self.kernel.route(&name)?))).collect()
    }

    fn losses(&self) -> Result<HashMap<String, u64>, String> {
        if let Some(error) = self.kernel.uncounted() {
            return Err(format!("frames that are lost after a redirect are not counted: {error}"));
        }
        let losses = self.kernel.losses().map_err(|error| error.to_string())?;
        let named = |(ifindex, lost)| Some((self.devices.get(&ifindex)?.name.clone(), lost));
        Ok(losses.into_iter().filter_map(named).collect())
    }

    fn begin_adoption(&mut self) -> Result<Option<Adopted>, UpdateError> {
        let adopted = self.kernel.adopted()?;
        if let Some(Adopted { config, ports, .. }) = &adopted {
            (self.config.own_bit, self.config.host_pair) = (config.own_bit, config.host_pair);
            self.adopted_ports = Some(ports.iter().map(|(port, _)| *port).collect());
        }
        Ok(adopted)
    }

    fn retain_permits(&mut self, permits: &HashSet<Permit>) -> Result<(), UpdateError> {
        self.kernel.forbid_all_but(permits)
    }

    fn end_adoption(&mut self) -> Result<(), UpdateError> {
        let ports = self.adopted_ports.take().unwrap_or_default();
        for ifindex in ports.iter().filter(|ifindex| !self.devices.contains_key(ifindex)) {
            self.kernel.clear_port(*ifindex)?;
        }
        if let Err(error) = self.kernel.programs.drop_left_over() {
            tracing::warn!(%error, "a program of an earlier daemon stays on an interface");
        }
        Ok(())
    }

    fn outlives(&self) -> bool {
        self.kernel.is_pinned()
    }

    fn unpin(&mut self) {
        if let Err(error) = self.kernel.unpin() {
            tracing::warn!(%error, "something stays in the kernel; `gdp-ctl xdp detach` removes it");
        }
    }
}

/// Removes the programs of an earlier daemon if this daemon does not use XDP. Otherwise they would
/// forward in parallel.
pub fn clear_left_over(config: &PlaneConfig) -> Result<(), PlaneError> {
    let Some(place) = &config.pins else { return Ok(()) };
    if pins::find(&place.bpffs)?.is_empty() {
        return Ok(());
    }
    let pins = Pins::open(place)?;
    if pins.any() {
        tracing::warn!("XDP is not used any more: removing what an earlier daemon left in the kernel");
        pins.remove()?;
    }
    Ok(())
}
