//! The section `dpdk` of the configuration: the devices that the DPDK plane drives, and the
//! resources that it may use.

use std::time::Duration;

use schemars::JsonSchema;
use serde::Deserialize;

use gdp_dataplane::dpdk::{AUXILIARY, BEFORE_XDP, DpdkConfig, DpdkPort, LARGEST_ROOM};

const MAX_PORTS: usize = 32;

/// The maximum length of an interface name, in bytes.
const MAX_INTERFACE: usize = 15;

/// The upper bound of core numbers, from the kernel's CPU sets, and the maximum number of loops,
/// below DPDK's thread limit.
const MAX_CORE: usize = libc::CPU_SETSIZE as usize;
const MAX_LOOPS: usize = 64;

/// The range of the memory size, in MiB.
const MEMORY: std::ops::RangeInclusive<u32> = 64..=65536;

/// The range of MTUs, in bytes: from IPv6's minimum to the largest packet buffer.
const MTU: std::ops::RangeInclusive<u16> = 1280..=(LARGEST_ROOM - AUXILIARY) as u16;

/// The default frame and block sizes of `net_af_packet`, in bytes. `BEFORE_PACKET` is what the
/// kernel puts before a packet, including its Ethernet header, in bytes.
const FRAMESZ: usize = 2048;
const BLOCKSZ: usize = 4096;
const BEFORE_PACKET: usize = 80;

/// The frame and block sizes to suggest, in bytes. Blocks are whole pages.
const FRAMES: [(usize, usize); 4] = [(FRAMESZ, BLOCKSZ), (4096, 4096), (8192, 8192), (LARGEST_ROOM, 4 * LARGEST_ROOM)];

/// The maximum packet buffer with a `net_af_xdp` device, in bytes. With its headroom, it must fit a
/// page.
const LARGEST_XDP: usize = 3072;

/// The maximum sleep of a loop, in microseconds.
const MAX_IDLE_US: u32 = 100_000;

/// The section `dpdk`, for `data_plane: dpdk`.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub(super) struct DpdkEntry {
    /// The devices that the plane drives, at most 32.
    ports: Vec<PortEntry>,
    /// Uses huge pages, which network cards need.
    huge_pages: bool,
    /// The memory of the plane in MiB, from 64 to 65536; by default 256.
    memory_mib: Option<u32>,
    /// Processor cores, one polling loop on each. By default one loop on any core.
    cores: Vec<usize>,
    /// The longest sleep of an idle loop in microseconds, up to 100000. 0 does not sleep.
    idle_us: Option<u32>,
}

/// A device of the DPDK plane.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct PortEntry {
    /// The name of the host's interface for it, up to 15 characters.
    interface: String,
    /// A PCI address, or a driver with its arguments.
    device: String,
    /// The MTU in bytes, at least 1280. By default 1500.
    mtu: Option<u32>,
}

impl DpdkEntry {
    pub fn check(self) -> Result<DpdkConfig, String> {
        let default = DpdkConfig::default();
        let mut ports: Vec<DpdkPort> = Vec::new();
        for PortEntry { interface, device, mtu } in self.ports {
            let is_name = (1..=MAX_INTERFACE).contains(&interface.len())
                && !interface.contains(|c: char| c == '/' || !c.is_ascii_graphic());
            if !is_name {
                return Err(format!(
                    "dpdk: {interface:?} is no name for an interface: 1 to {MAX_INTERFACE} visible characters \
                     without a slash"
                ));
            }
            if device.is_empty() || !device.chars().all(|c| c.is_ascii_graphic()) {
                return Err(format!(
                    "dpdk: {device:?} is no device; one is a PCI address such as 0000:02:00.0, or a driver with its \
                     arguments such as \
                     net_af_xdp0,iface=eth0"
                ));
            }
            let mtu = mtu.map(|mtu| check_mtu(&interface, mtu)).transpose()?;
            let port = DpdkPort { interface, device, mtu };
            if port.carrier() == Some(&port.interface) {
                return Err(format!(
                    "dpdk: {} cannot be both the device and the host's side of it; give that another name, such as \
                     gdp0, and the addresses of \
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
            if port.is_af_packet() {
                check_frames(&port)?;
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
        let config = DpdkConfig { ports, huge_pages: self.huge_pages, memory_mib, cores: self.cores, idle };
        let xdp = config.ports.iter().find(|port| port.is_af_xdp()).filter(|_| config.room() > LARGEST_XDP);
        if let Some(xdp) = xdp {
            return Err(format!(
                "dpdk: {} takes packets that fit a page: with it no port has an mtu above {}, or framesz above \
                 {LARGEST_XDP}",
                xdp.name(),
                LARGEST_XDP - AUXILIARY - BEFORE_XDP
            ));
        }
        Ok(config)
    }
}

fn check_mtu(interface: &str, mtu: u32) -> Result<u16, String> {
    let within = u16::try_from(mtu).ok().filter(|mtu| MTU.contains(mtu));
    within.ok_or_else(|| format!("dpdk: {interface}: an mtu of {mtu} is not between {} and {}", MTU.start(), MTU.end()))
}

/// Checks that the frame and block sizes of `net_af_packet`, from the port's arguments, suit its
/// MTU.
fn check_frames(port: &DpdkPort) -> Result<(), String> {
    let (name, mtu) = (port.name(), port.mtu());
    let (framesz, blocksz) = (port.argument("framesz").unwrap_or(FRAMESZ), port.argument("blocksz").unwrap_or(BLOCKSZ));
    let needed = usize::from(mtu) + BEFORE_PACKET;
    let fits = FRAMES.into_iter().find(|(framesz, _)| *framesz >= needed);
    let Some((enough, for_several)) = fits.filter(|_| framesz <= LARGEST_ROOM) else {
        let most = LARGEST_ROOM - BEFORE_PACKET;
        return Err(format!("dpdk: {name}: there is room for an mtu of {most} at most, with framesz={LARGEST_ROOM}"));
    };
    if framesz < needed {
        return Err(format!(
            "dpdk: {name}: an mtu of {mtu} needs framesz={enough},blocksz={for_several} among its arguments"
        ));
    }
    // Otherwise the driver reads packets at wrong offsets.
    if !blocksz.is_multiple_of(framesz) {
        return Err(format!("dpdk: {name}: blocksz={blocksz} is no multiple of framesz={framesz}"));
    }
    Ok(())
}
