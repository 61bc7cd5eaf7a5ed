//! The DPDK plane: devices that this process drives itself, connected by the loops of `gdp-dpdk`.
//! It forwards by the tables of the userspace plane. As with XDP, the userspace plane runs behind
//! it. Frames that the loops do not handle reach the userspace plane through the host interfaces of
//! the ports.
//!
//! Without the feature `dpdk`, [`start`] returns an error.

#[cfg(not(feature = "dpdk"))]
mod absent;
#[cfg(feature = "dpdk")]
mod present;
#[cfg(feature = "dpdk")]
mod routes;
#[cfg(feature = "dpdk")]
mod settings;

use std::time::Duration;

#[cfg(not(feature = "dpdk"))]
pub(crate) use absent::{restore_settings, start};
#[cfg(feature = "dpdk")]
pub use present::{LoopReader, LoopView};
#[cfg(feature = "dpdk")]
pub(crate) use present::{restore_settings, start};

/// Reason why the userspace plane serves an interface that is not a port of the DPDK plane.
pub(crate) const NOT_A_PORT: &str = "`data_plane: dpdk` was asked for, and this is none of its ports";

/// Default MTU of a port.
pub const DEFAULT_MTU: u16 = 1500;

/// Unit of packet buffers: 1 KiB, as some network cards require. Buffers have 2 to 9 KiB; 9 KiB fit
/// a jumbo frame.
const ROOM_UNIT: usize = 1024;
const SMALLEST_ROOM: usize = 2 * ROOM_UNIT;
pub const LARGEST_ROOM: usize = 9 * ROOM_UNIT;

/// Bytes besides a packet that network cards count towards its buffer: Ethernet header, two VLAN
/// tags and the checksum.
pub const AUXILIARY: usize = 14 + 4 + 4 + 4;

/// Headroom that the kernel reserves in front of a packet for `net_af_xdp`.
pub const BEFORE_XDP: usize = 256;

/// Configuration of the DPDK plane.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DpdkConfig {
    pub ports: Vec<DpdkPort>,
    /// Whether DPDK uses huge pages.
    pub huge_pages: bool,
    /// Maximum ordinary memory in MiB, if huge pages are not used.
    pub memory_mib: u32,
    /// The core of each loop. Empty: a single loop on any core.
    pub cores: Vec<usize>,
    /// Maximum sleep of an idle loop. 0: the loop polls its devices continuously.
    pub idle: Duration,
}

impl Default for DpdkConfig {
    fn default() -> Self {
        Self {
            ports: Vec::new(),
            huge_pages: false,
            memory_mib: 256,
            cores: Vec::new(),
            idle: Duration::from_micros(250),
        }
    }
}

/// A device, and the host's interface for it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DpdkPort {
    /// Interface that the daemon creates at startup; addresses are assigned here.
    pub interface: String,
    /// Device in DPDK notation: a PCI address, or a driver with its arguments, such as
    /// `net_af_packet0,iface=eth0`.
    pub device: String,
    /// Size in bytes of the largest packet without its Ethernet header. `None`: [`DEFAULT_MTU`],
    /// and the MTU of a kernel interface used as the device is unchanged.
    pub mtu: Option<u16>,
}

impl DpdkConfig {
    /// Returns a buffer size that fits the packets of all ports.
    pub fn room(&self) -> usize {
        let most = self.ports.iter().map(DpdkPort::room).max().unwrap_or(0);
        most.next_multiple_of(ROOM_UNIT).max(SMALLEST_ROOM)
    }
}

impl DpdkPort {
    pub fn mtu(&self) -> u16 {
        self.mtu.unwrap_or(DEFAULT_MTU)
    }

    /// Returns the buffer size that packets of this port need. `net_af_packet` requires at least
    /// its frame size.
    fn room(&self) -> usize {
        let before = if self.is_af_xdp() { BEFORE_XDP } else { 0 };
        let frame = if self.is_af_packet() { self.argument("framesz").unwrap_or(0) } else { 0 };
        (usize::from(self.mtu()) + AUXILIARY + before).max(frame)
    }

    /// Returns a numeric argument of the device.
    pub fn argument(&self, name: &str) -> Option<usize> {
        let value = |argument: &'_ str| argument.strip_prefix(name)?.strip_prefix('=')?.parse().ok();
        self.device.split(',').find_map(value)
    }

    /// Returns the device without its arguments.
    pub fn name(&self) -> &str {
        self.device.split(',').next().unwrap_or_default()
    }

    /// Returns the device with its arguments if it is a PCI network card.
    pub fn pci(&self) -> Option<&str> {
        // Format: 0000:02:00.0
        let is_at = |at: usize, c: u8| self.name().as_bytes().get(at) == Some(&c);
        (self.name().len() == 12 && is_at(4, b':') && is_at(7, b':') && is_at(10, b'.')).then_some(&self.device)
    }

    /// Returns whether this is `net_af_packet`. With it, the kernel processes packets before DPDK
    /// receives them.
    pub fn is_af_packet(&self) -> bool {
        self.name().starts_with("net_af_packet")
    }

    pub fn is_af_xdp(&self) -> bool {
        self.name().starts_with("net_af_xdp")
    }

    /// Returns the kernel interface that the device uses, if any.
    pub fn carrier(&self) -> Option<&str> {
        self.device.split(',').find_map(|argument| argument.strip_prefix("iface="))
    }
}

/// Reasons why the DPDK plane cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum DpdkPlaneError {
    #[error("this gdp-ctl was built without the feature `dpdk`: build with `cargo build -p gdp-ctl --features dpdk`")]
    NotBuilt,
    #[error("there is no `dpdk.ports` in the configuration: each takes an interface's name and a device")]
    NoPorts,
    #[cfg(feature = "dpdk")]
    #[error("{device}: its interface {interface} takes no MTU of {mtu}: {source}; choose a smaller `mtu`")]
    Mtu { device: String, interface: String, mtu: u16, source: std::io::Error },
    #[cfg(feature = "dpdk")]
    #[error(transparent)]
    Eal(#[from] gdp_dpdk::EalError),
    #[cfg(feature = "dpdk")]
    #[error(transparent)]
    Switch(#[from] gdp_dpdk::SwitchError),
}

/// Counters of a port's device, where the plane runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DeviceCounters {
    pub received: u64,
    pub sent: u64,
    /// Packets that arrived and were lost in the device.
    pub missed: u64,
    /// Packets passed to the device that did not leave.
    pub failed: u64,
}

#[cfg(test)]
#[path = "../../tests/unit/dpdk.rs"]
mod tests;
