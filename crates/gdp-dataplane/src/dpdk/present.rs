//! The plane itself, in a build that has it.

use std::collections::HashMap;
use std::net::{IpAddr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use gdp_dpdk::local::{Local, NextHop};
use gdp_dpdk::{Eal, EalConfig, Idle, Memory, PortCounters, Switch, SwitchConfig};
use gdp_link::link::KeyedEntry;
use gdp_link::port::interface_index;
use gdp_wire::table::{ip_of, mac_words};
use gdp_wire::{Counter, LinkEntry, Name};

use super::routes::Routes;
use super::settings::{self, Settings};
use super::{DeviceCounters, DpdkConfig, DpdkPlaneError, LARGEST_ROOM};
use crate::device::Device;
use crate::forwarder_state::Shared;
use crate::{tables::Reader, tables::View, udp};

const _: () = assert!(LARGEST_ROOM == gdp_dpdk::mbuf::LARGEST);

/// Ports and loops. Dropping it lets go of the devices.
pub struct DpdkPlane {
    switch: Switch,
    /// By the number of a port, which is the index of the host's interface.
    ports: HashMap<u32, Held>,
    routes: Option<Routes>,
    /// Goes after the devices are given back.
    _settings: Settings,
}

/// A port as it is held here.
struct Held {
    interface: String,
    device: String,
    mac: [u16; 3],
    /// The index of the kernel's interface that the device is, if it is one.
    carrier: Option<u32>,
}

impl DpdkPlane {
    /// Takes all devices over, in the network namespace of the calling thread. `kept`: the file for
    /// what their interfaces' settings were. `reader`: makes each loop its way to the tables.
    pub fn start(
        config: &DpdkConfig,
        kept: Option<PathBuf>,
        ethertype: u16,
        mut reader: impl FnMut() -> Reader,
        shared: &Arc<Shared>,
    ) -> Result<Self, DpdkPlaneError> {
        if config.ports.is_empty() {
            return Err(DpdkPlaneError::NoPorts);
        }
        let pci = config.ports.iter().filter_map(|port| port.pci()).map(str::to_owned).collect();
        let memory = if config.huge_pages { Memory::HugePages } else { Memory::Ordinary { mib: config.memory_mib } };
        let eal = Eal::begin(&EalConfig { memory, pci })?;
        let idle = if config.idle.is_zero() { Idle::Busy } else { Idle::Sleep(config.idle) };
        let (cores, count) = (config.cores.clone(), config.ports.len());
        let loops = SwitchConfig { cores, idle, ports: count, largest: config.room() };
        // Before the switch, so that they are put back after it.
        let mut settings = Settings::open(kept);
        let mut ports = HashMap::new();
        let mut switch = Switch::start(eal, &loops, || LoopReader::new(reader(), shared.clone()))?;
        switch.set_local(Local { ethertype, ..Local::default() });
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
            let held = Held { interface, device, mac: mac_words(mac), carrier };
            ports.insert(number, held);
        }
        let routes = Routes::open().inspect_err(|error| {
            tracing::warn!(%error, "the kernel's routes cannot be asked for; links over UDP are sent on by the \
                                    userspace plane");
        });
        Ok(Self { switch, ports, routes: routes.ok(), _settings: settings })
    }

    /// Puts back the settings of interfaces that a daemon with this plane has left in the file
    /// `kept`, as it was killed. In the network namespace of the calling thread.
    pub fn put_back_left(kept: &Path) {
        if kept.exists()
            && let Err(error) = settings::put_back_left(kept.to_owned())
        {
            let path = kept.display();
            tracing::warn!(%error, "interfaces stay set as a daemon with DPDK has left them: {path} is of no use");
        }
    }

    /// The device behind an interface, if this plane has it.
    pub fn device_of(&self, interface: u32) -> Option<&str> {
        self.ports.get(&interface).map(|held| held.device.as_str())
    }

    /// Whether this plane can send the datagrams of a link now.
    pub fn routes(&self, link: &LinkEntry) -> bool {
        self.switch.local().next_hops.get(link.id).is_some()
    }

    /// Looks again at what is for this switch, where links over UDP leave, and which devices have a
    /// carrier. `bound`: where the UDP socket takes frames; `vlans`: those that GDP runs on, each
    /// with the port below it.
    pub fn follow<'l>(
        &mut self,
        bound: Option<SocketAddr>,
        vlans: &[(u32, u16)],
        links: impl Iterator<Item = &'l KeyedEntry>,
    ) {
        self.switch.follow_carriers(|port| self.ports.get(&port).is_none_or(Held::is_running));
        let before = self.switch.local();
        let addresses = match (bound, udp::addresses()) {
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
        let local = Local { ethertype: before.ethertype, addresses, vlans: vlans.to_vec(), next_hops };
        if local != *before {
            self.switch.set_local(local);
        }
    }

    /// Looks where a link leaves, if it is one over UDP.
    pub fn follow_link(&mut self, link: &LinkEntry) {
        let (before, hop) = (self.switch.local(), self.next_hop(link));
        if before.next_hops.get(link.id) != hop.as_ref() {
            let mut local = Local::clone(&before);
            local.next_hops.set(link.id, hop);
            self.switch.set_local(local);
        }
    }

    fn next_hop(&self, link: &LinkEntry) -> Option<NextHop> {
        let carrier = &link.carrier;
        if carrier.kind == gdp_wire::Carrier::ETHERNET || carrier.local_ip == [0; 4] {
            return None;
        }
        let (from, to) = (ip_of(carrier.kind, carrier.local_ip), ip_of(carrier.kind, carrier.peer_ip));
        // There is one on every interface.
        if matches!(to, IpAddr::V6(to) if to.is_unicast_link_local()) {
            return None;
        }
        let leaves = self.routes.as_ref()?.lookup(from, to)?;
        let local = self.ports.get(&leaves.interface)?.mac;
        Some(NextHop { port: leaves.interface, peer: mac_words(leaves.mac), local })
    }

    pub fn counters(&self) -> [u64; Counter::COUNT] {
        self.switch.counters()
    }

    /// Frames that were lost after the decision, by the name of the interface they were to leave
    /// by.
    pub fn losses(&self) -> HashMap<String, u64> {
        let named = |(port, lost)| Some((self.ports.get(&port)?.interface.clone(), lost));
        self.switch.losses().filter_map(named).collect()
    }

    /// What devices have counted, by the name of the interface on the host's side.
    pub fn devices(&self) -> HashMap<String, DeviceCounters> {
        let named = |(port, counted): (u32, PortCounters)| {
            let PortCounters { received, sent, missed, failed } = counted;
            Some((self.ports.get(&port)?.interface.clone(), DeviceCounters { received, sent, missed, failed }))
        };
        self.switch.port_counters().filter_map(named).collect()
    }

    /// What each loop has taken.
    pub fn processor_time(&self) -> Vec<Duration> {
        self.switch.processor_time()
    }
}

impl Held {
    /// Whether the device's cable is there, as far as the kernel knows: `net_af_packet` and
    /// `net_af_xdp` do not ask it.
    fn is_running(&self) -> bool {
        let Some(carrier) = self.carrier else { return true };
        // It may have been deleted. Otherwise nothing is known.
        Device::is_running(carrier).unwrap_or_else(|error| error.raw_os_error() != Some(libc::ENODEV))
    }
}

/// A loop's way to the tables, and to where it counts.
pub struct LoopReader {
    tables: Reader,
    shared: Arc<Shared>,
}

impl LoopReader {
    pub fn new(tables: Reader, shared: Arc<Shared>) -> Self {
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
