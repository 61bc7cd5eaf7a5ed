//! The DPDK plane in a build with the feature `dpdk`.

use std::collections::HashMap;
use std::net::{IpAddr, SocketAddr};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use gdp_dpdk::local::{Local, NextHop};
use gdp_dpdk::{Eal, EalConfig, Idle, Memory, PortCounters, Switch, SwitchConfig};
use gdp_link::link::KeyedEntry;
use gdp_link::port::interface_index;
use gdp_wire::table::{PORT_ROUTED, ip_of, mac_words};
use gdp_wire::{Counter, LinkEntry, Name, Vlan};

use super::routes::Routes;
use super::settings::{self, Settings};
use super::{DeviceCounters, DpdkPlaneError, LARGEST_ROOM, NOT_A_PORT};
use crate::config::PlaneConfig;
use crate::data_plane::{DataPlane, FastPath};
use crate::device::Device;
use crate::forwarder_state::Shared;
use crate::host_pair::Ends;
use crate::interface_plane::InterfacePlane;
use crate::kernel_failures::UpdateError;
use crate::tables::{TablesReader, View};
use crate::udp;
use crate::userspace_plane::UserspacePlane;

const _: () = assert!(LARGEST_ROOM == gdp_dpdk::mbuf::LARGEST);

/// Ports and loops. Dropping it releases the devices.
struct DpdkPlane {
    switch: Switch,
    /// By port number, which is the index of the host's interface.
    ports: HashMap<u32, PortDevice>,
    routes: Option<Routes>,
    /// Address at which the UDP socket receives frames.
    bound: Option<SocketAddr>,
    /// Dropped after the devices have been released.
    _settings: Settings,
}

/// A port of the switch.
struct PortDevice {
    interface: String,
    device: String,
    mac: [u16; 3],
    /// Index of the kernel interface that the device uses, if any.
    carrier: Option<u32>,
}

/// Takes over all devices, in the network namespace of the calling thread.
pub fn start(config: &PlaneConfig, userspace: &UserspacePlane) -> Result<Box<dyn FastPath>, DpdkPlaneError> {
    let PlaneConfig { ethertype, dpdk: config, dpdk_settings, .. } = config;
    if config.ports.is_empty() {
        return Err(DpdkPlaneError::NoPorts);
    }
    let pci = config.ports.iter().filter_map(|port| port.pci()).map(str::to_owned).collect();
    let memory = if config.huge_pages { Memory::HugePages } else { Memory::Ordinary { mib: config.memory_mib } };
    let eal = Eal::begin(&EalConfig { memory, pci })?;
    let idle = if config.idle.is_zero() { Idle::Busy } else { Idle::Sleep(config.idle) };
    let (cores, count) = (config.cores.clone(), config.ports.len());
    let loops = SwitchConfig { cores, idle, ports: count, largest: config.room() };
    // Declared before the switch, so that they are restored after it is dropped.
    let mut settings = Settings::open(dpdk_settings.clone());
    let mut ports = HashMap::new();
    let reader = || LoopReader::new(userspace.tables.reader(), userspace.shared.clone());
    let mut switch = Switch::start(eal, &loops, reader)?;
    switch.set_local(Local { ethertype: *ethertype, ..Local::default() });
    for port in &config.ports {
        if let Some(carrier) = port.carrier() {
            settings.quieten(carrier);
            if port.is_af_packet() {
                settings.keep_whole(carrier);
            }
            if let Some(mtu) = port.mtu {
                settings.set_mtu(carrier, mtu).map_err(|source| {
                    let (device, interface) = (port.name().to_owned(), carrier.to_owned());
                    DpdkPlaneError::Mtu { device, interface, mtu, source }
                })?;
            }
        }
        let (number, mac) = switch.add_port(&port.device, (&port.interface, port.mtu()), interface_index)?;
        tracing::info!("{}: DPDK device {}", port.interface, port.device);
        let carrier = port.carrier().and_then(|carrier| interface_index(carrier).ok());
        let (interface, device) = (port.interface.clone(), port.device.clone());
        ports.insert(number, PortDevice { interface, device, mac: mac_words(mac), carrier });
    }
    let routes = Routes::open().inspect_err(|error| {
        tracing::warn!(%error, "the kernel's routes cannot be asked for; links over UDP are sent on by the \
                                userspace plane");
    });
    Ok(Box::new(DpdkPlane { switch, ports, routes: routes.ok(), bound: None, _settings: settings }))
}

/// Restores interface settings that a killed daemon with this plane left in a file. Applies to the
/// network namespace of the calling thread.
pub fn restore_settings(file: &Path) {
    if file.exists()
        && let Err(error) = settings::put_back_left(file.to_owned())
    {
        let path = file.display();
        tracing::warn!(%error, "interfaces stay set as a daemon with DPDK has left them: {path} is of no use");
    }
}

impl DpdkPlane {
    fn next_hop(&self, link: &LinkEntry) -> Option<NextHop> {
        let carrier = &link.carrier;
        if carrier.kind == gdp_wire::Carrier::ETHERNET || carrier.local_ip == [0; 4] {
            return None;
        }
        let (from, to) = (ip_of(carrier.kind, carrier.local_ip), ip_of(carrier.kind, carrier.peer_ip));
        // Every interface has a link-local network, so the address alone gives no egress interface.
        if matches!(to, IpAddr::V6(to) if to.is_unicast_link_local()) {
            return None;
        }
        let leaves = self.routes.as_ref()?.lookup(from, to)?;
        let local = self.ports.get(&leaves.interface)?.mac;
        Some(NextHop { port: leaves.interface, peer: mac_words(leaves.mac), local })
    }
}

/// Forwards by the tables of the userspace plane, and counts arrivals there.
impl DataPlane for DpdkPlane {
    fn counters(&self) -> Result<[u64; Counter::COUNT], UpdateError> {
        Ok(self.switch.counters())
    }
}

impl FastPath for DpdkPlane {
    fn name(&self) -> &'static str {
        "dpdk"
    }

    fn xdp(&self) -> Result<(), String> {
        Err(NOT_A_PORT.to_owned())
    }

    fn attach_udp(&mut self, bound: SocketAddr, _: Option<Ends>) -> Result<(), UpdateError> {
        self.bound = Some(bound);
        Ok(())
    }

    fn detach_udp(&mut self) {
        self.bound = None;
    }

    fn describe(&self, interface: &str, device: u32) -> InterfacePlane {
        match self.ports.get(&device) {
            Some(port) => {
                let (interface, reason) = (interface.to_owned(), format!("device {}", port.device));
                InterfacePlane { interface, kind: "dpdk", reason, left_alone: false }
            }
            None => InterfacePlane::userspace(interface, NOT_A_PORT),
        }
    }

    fn resolve(&mut self, link: &LinkEntry) {
        let (before, hop) = (self.switch.local(), self.next_hop(link));
        if before.next_hops.get(link.id) != hop.as_ref() {
            let mut local = Local::clone(&before);
            local.next_hops.set(link.id, hop);
            self.switch.set_local(local);
        }
    }

    fn egress_port(&self, link: &LinkEntry, device: Option<u32>) -> Option<u32> {
        match device {
            Some(device) => self.ports.contains_key(&device).then_some(device),
            // An endpoint on this host is reached through the host pair.
            None if link.carrier.local_mac != [0; 3] => None,
            None => self.switch.local().next_hops.get(link.id).map(|_| PORT_ROUTED),
        }
    }

    /// Updates the addresses of this switch, the next hops of links over UDP, and the carrier state
    /// of the devices.
    fn begin_refresh(
        &mut self,
        vlans: &[Vlan],
        links: &mut dyn Iterator<Item = &KeyedEntry>,
    ) -> Result<(), UpdateError> {
        self.switch.follow_carriers(|port| self.ports.get(&port).is_none_or(PortDevice::is_running));
        let before = self.switch.local();
        let addresses = match (self.bound, udp::addresses()) {
            (None, _) => Vec::new(),
            (Some(bound), Ok(all)) => {
                let mut taken: Vec<_> = udp::taken_at(bound, all).into_iter().map(|(address, _)| address).collect();
                taken.dedup();
                taken
            }
            (Some(_), Err(error)) => {
                tracing::warn!(%error, "the addresses of interfaces cannot be read; UDP is taken where it was");
                before.addresses.clone()
            }
        };
        let next_hops = links.filter_map(|link| Some((link.id, self.next_hop(link)?))).collect();
        let vlans = vlans.iter().map(|vlan| (vlan.ifindex, vlan.id as u16)).collect();
        let local = Local { ethertype: before.ethertype, addresses, vlans, next_hops };
        if local != *before {
            self.switch.set_local(local);
        }
        Ok(())
    }

    fn losses(&self) -> Result<HashMap<String, u64>, String> {
        let named = |(port, lost)| Some((self.ports.get(&port)?.interface.clone(), lost));
        Ok(self.switch.losses().filter_map(named).collect())
    }

    fn device_counters(&self) -> HashMap<String, DeviceCounters> {
        let named = |(port, counted): (u32, PortCounters)| {
            let PortCounters { received, sent, missed, failed } = counted;
            Some((self.ports.get(&port)?.interface.clone(), DeviceCounters { received, sent, missed, failed }))
        };
        self.switch.port_counters().filter_map(named).collect()
    }

    fn processor_time(&self) -> Vec<Duration> {
        self.switch.processor_time()
    }
}

impl PortDevice {
    /// Returns whether the kernel reports a carrier for the device. `net_af_packet` and
    /// `net_af_xdp` do not query it.
    fn is_running(&self) -> bool {
        let Some(carrier) = self.carrier else { return true };
        // ENODEV: the interface has been deleted. On any other error the state is unknown and
        // counts as running.
        Device::is_running(carrier).unwrap_or_else(|error| error.raw_os_error() != Some(libc::ENODEV))
    }
}

/// Access of a loop to the tables and counters.
pub struct LoopReader {
    tables: TablesReader,
    shared: Arc<Shared>,
}

impl LoopReader {
    pub fn new(tables: TablesReader, shared: Arc<Shared>) -> Self {
        Self { tables, shared }
    }
}

/// The tables as a loop sees them during a batch.
pub struct LoopView<'a> {
    tables: View<'a>,
    shared: &'a Shared,
}

impl gdp_dpdk::view::Reader for LoopReader {
    type View<'a> = LoopView<'a>;

    #[inline]
    fn enter(&mut self) -> LoopView<'_> {
        LoopView { tables: self.tables.enter(), shared: &self.shared }
    }
}

impl<'a> gdp_dpdk::view::View for LoopView<'a> {
    type Tables = View<'a>;

    #[inline]
    fn tables(&self) -> &View<'a> {
        &self.tables
    }

    #[inline]
    fn members(&self, group: u32) -> impl Iterator<Item = u32> {
        self.tables.members(group)
    }

    #[inline]
    fn next_counts(&self, link: &LinkEntry, frames: u64) -> u64 {
        self.tables.next_counts(link.id, frames)
    }

    #[inline]
    fn prefetch(&self, name: &Name) {
        self.tables.prefetch(name);
    }

    #[inline]
    fn count_arrivals(&self, link: u32, counter: Counter, frames: u64) {
        self.shared.tally.count_arrivals(link, counter, frames);
    }

    fn sample(&self, name: &Name) {
        self.shared.tally.sample(name);
    }
}
