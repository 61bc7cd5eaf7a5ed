//! The section `dpdk` of the configuration: the devices that the DPDK plane drives by itself, and what it may take for that.

use std::time::Duration;

use serde::Deserialize;

use crate::plane::dpdk::{DpdkConfig, DpdkPort};

const MAX_PORTS: usize = 32;

/// Bytes of an interface's name.
const MAX_INTERFACE: usize = 15;

/// As the kernel's sets of cores have room for; and DPDK has for threads, with some to spare.
const MAX_CORE: usize = libc::CPU_SETSIZE as usize;
const MAX_LOOPS: usize = 64;

/// MiB of memory.
const MEMORY: std::ops::RangeInclusive<u32> = 64..=65536;

/// The longest sleep of a loop.
const MAX_IDLE_US: u32 = 100_000;

/// As it is written.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct DpdkEntry {
    ports: Vec<PortEntry>,
    huge_pages: bool,
    memory_mib: Option<u32>,
    cores: Vec<usize>,
    idle_us: Option<u32>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct PortEntry {
    interface: String,
    device: String,
}

impl DpdkEntry {
    pub fn check(self) -> Result<DpdkConfig, String> {
        let default = DpdkConfig::default();
        let mut ports: Vec<DpdkPort> = Vec::new();
        for PortEntry { interface, device } in self.ports {
            let is_name = (1..=MAX_INTERFACE).contains(&interface.len())
                && !interface.contains(|c: char| c == '/' || !c.is_ascii_graphic());
            if !is_name {
                return Err(format!(
                    "dpdk: {interface:?} is no name for an interface: 1 to {MAX_INTERFACE} visible characters without a slash"
                ));
            }
            if device.is_empty() || !device.chars().all(|c| c.is_ascii_graphic()) {
                return Err(format!(
                    "dpdk: {device:?} is no device; one is a PCI address such as 0000:02:00.0, or a driver with its arguments such as \
                     net_af_xdp0,iface=eth0"
                ));
            }
            let port = DpdkPort { interface, device };
            if port.carrier() == Some(&port.interface) {
                return Err(format!(
                    "dpdk: {} cannot be both the device and the host's side of it; give that another name, such as gdp0, and the addresses of \
                     {} with it",
                    port.interface, port.interface
                ));
            }
            let is_same = |other: &DpdkPort| {
                let same_carrier = port.carrier().is_some() && other.carrier() == port.carrier();
                other.interface == port.interface || other.name() == port.name() || same_carrier
            };
            if ports.iter().any(is_same) {
                return Err(format!("dpdk: {} or {} is listed twice", port.interface, port.name()));
            }
            if port.name().contains(':') && port.pci().is_none() {
                return Err(format!("dpdk: {} is no PCI address as `lspci -D` has them: 0000:02:00.0", port.name()));
            }
            if port.pci().is_some() && !self.huge_pages {
                return Err(format!("dpdk: {} is a network card, which needs huge_pages: true", port.name()));
            }
            ports.push(port);
        }
        if ports.len() > MAX_PORTS {
            return Err(format!("dpdk: {} ports, where at most {MAX_PORTS} are driven", ports.len()));
        }
        let memory_mib = self.memory_mib.unwrap_or(default.memory_mib);
        if !MEMORY.contains(&memory_mib) {
            return Err(format!(
                "dpdk: memory_mib: {memory_mib} is not between {} and {}",
                MEMORY.start(),
                MEMORY.end()
            ));
        }
        let idle = self.idle_us.map_or(default.idle, |idle| Duration::from_micros(idle.into()));
        if idle > Duration::from_micros(MAX_IDLE_US.into()) {
            return Err(format!("dpdk: idle_us: loops sleep {MAX_IDLE_US} µs at most; 0 is not at all"));
        }
        let mut cores = self.cores.clone();
        cores.sort_unstable();
        cores.dedup();
        if cores.len() != self.cores.len()
            || cores.last().is_some_and(|core| *core >= MAX_CORE)
            || cores.len() > MAX_LOOPS
        {
            return Err(format!("dpdk: cores: at most {MAX_LOOPS} different ones below {MAX_CORE}"));
        }
        Ok(DpdkConfig { ports, huge_pages: self.huge_pages, memory_mib, cores: self.cores, idle })
    }
}
