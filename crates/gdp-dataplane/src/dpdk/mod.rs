//! The DPDK plane: devices that this process drives by itself, with the loops of `gdp-dpdk` between
//! them. It decides by the tables of the userspace plane, which stays behind it, as behind XDP:
//! what the loops leave to it reaches it by the host's sides of the ports.
//!
//! Without the feature `dpdk` there is none, and [`start`] says so.

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

/// Why the userspace plane takes what arrives on an interface that is no port of the DPDK plane.
pub(crate) const NOT_A_PORT: &str = "`data_plane: dpdk` was asked for, and this is none of its ports";

/// MTU of a port that is given none.
pub const DEFAULT_MTU: u16 = 1500;

/// Room for packets comes in KiB, as some network cards count it. From 2 to 9 of them: a jumbo
/// frame.
const ROOM_UNIT: usize = 1024;
const SMALLEST_ROOM: usize = 2 * ROOM_UNIT;
pub const LARGEST_ROOM: usize = 9 * ROOM_UNIT;

/// Bytes beside a packet that count where network cards compare with the room for it: its Ethernet
/// header, two VLANs, and the checksum.
pub const AUXILIARY: usize = 14 + 4 + 4 + 4;

/// What the kernel keeps free in front of a packet for `net_af_xdp`.
pub const BEFORE_XDP: usize = 256;

/// How the DPDK plane is set up.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DpdkConfig {
    pub ports: Vec<DpdkPort>,
    /// Whether its memory is huge pages.
    pub huge_pages: bool,
    /// Of ordinary memory that it may take, in MiB, if it is not huge pages.
    pub memory_mib: u32,
    /// The core of each loop; none: one loop, on any core.
    pub cores: Vec<usize>,
    /// How long a loop sleeps at most while nothing arrives; 0: it asks its devices without end.
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

/// A device, and the interface that the host has of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DpdkPort {
    /// Made when the daemon starts; addresses belong here.
    pub interface: String,
    /// As DPDK writes devices: a PCI address, or a driver with its arguments, as
    /// `net_af_packet0,iface=eth0`.
    pub device: String,
    /// Bytes of the largest packet behind its Ethernet header; none: [`DEFAULT_MTU`], and an
    /// interface that is the device keeps what it has.
    pub mtu: Option<u16>,
}

impl DpdkConfig {
    /// Room for a packet that all ports can share.
    pub fn room(&self) -> usize {
        let most = self.ports.iter().map(DpdkPort::room).max().unwrap_or(0);
        most.next_multiple_of(ROOM_UNIT).max(SMALLEST_ROOM)
    }
}

impl DpdkPort {
    pub fn mtu(&self) -> u16 {
        self.mtu.unwrap_or(DEFAULT_MTU)
    }

    /// Room that a packet of this port needs. `net_af_packet` wants as much as its frames have.
    fn room(&self) -> usize {
        let before = if self.is_af_xdp() { BEFORE_XDP } else { 0 };
        let frame = if self.is_af_packet() { self.argument("framesz").unwrap_or(0) } else { 0 };
        (usize::from(self.mtu()) + AUXILIARY + before).max(frame)
    }

    /// A number among the device's arguments.
    pub fn argument(&self, name: &str) -> Option<usize> {
        let value = |argument: &'_ str| argument.strip_prefix(name)?.strip_prefix('=')?.parse().ok();
        self.device.split(',').find_map(value)
    }

    /// The device without its arguments.
    pub fn name(&self) -> &str {
        self.device.split(',').next().unwrap_or_default()
    }

    /// The device, with its arguments, if it is a network card.
    pub fn pci(&self) -> Option<&str> {
        // 0000:02:00.0
        let is_at = |at: usize, c: u8| self.name().as_bytes().get(at) == Some(&c);
        (self.name().len() == 12 && is_at(4, b':') && is_at(7, b':') && is_at(10, b'.')).then_some(&self.device)
    }

    /// Whether it is `net_af_packet`, by which the kernel handles packets before DPDK gets them.
    pub fn is_af_packet(&self) -> bool {
        self.name().starts_with("net_af_packet")
    }

    pub fn is_af_xdp(&self) -> bool {
        self.name().starts_with("net_af_xdp")
    }

    /// The interface of the kernel that the device is, if it is one.
    pub fn carrier(&self) -> Option<&str> {
        self.device.split(',').find_map(|argument| argument.strip_prefix("iface="))
    }
}

/// The DPDK plane cannot be used.
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

/// What is said of a port's device, where the plane runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DeviceCounters {
    pub received: u64,
    pub sent: u64,
    /// Arrived, and were lost in the device.
    pub missed: u64,
    /// Handed to it, and did not leave.
    pub failed: u64,
}

#[cfg(test)]
#[path = "../../tests/unit/dpdk.rs"]
mod tests;
