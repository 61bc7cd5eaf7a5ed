//! What [`super::gather`] finds and [`super::examine`] judges.

use std::net::SocketAddr;

use gdp_dataplane::device::{Device, Offloads};
use gdp_dataplane::kernel_version::KernelVersion;
use gdp_dataplane::xdp_features::Features;

/// Of one host, in one network namespace.
#[derive(Clone, Debug)]
pub struct Facts {
    pub clock: Clock,
    pub wanted: Wanted,
    /// If that is DPDK.
    pub dpdk: Option<Dpdk>,
    pub kernel: KernelVersion,
    /// Capabilities the daemon needs and this process has not.
    pub missing_capabilities: Vec<&'static str>,
    /// Whether what the loss counters need is in the kernel.
    pub losses: Result<(), String>,
    /// None if the configuration turns pinning off.
    pub bpffs: Option<Bpffs>,
    pub object: Result<Loaded, String>,
    pub left_over: Vec<LeftOver>,
    /// None if the configuration turns UDP off.
    pub udp: Option<UdpFacts>,
    /// The interfaces to run on, or the name of one that is not there.
    pub interfaces: Result<Vec<Result<Interface, String>>, String>,
}

/// The data plane that the daemon would try for.
#[derive(Clone, Copy, Debug)]
pub enum Wanted {
    Xdp,
    Dpdk,
    /// And why.
    Userspace(&'static str),
}

/// What DPDK is to find, if it is wanted.
#[derive(Clone, Debug)]
pub struct Dpdk {
    /// Whether this program can use it.
    pub built: bool,
    pub root: bool,
    /// Those that are free, if huge pages are wanted.
    pub huge_pages: Option<u64>,
    pub ports: Vec<DpdkPort>,
}

/// A port of the configuration.
#[derive(Clone, Debug)]
pub struct DpdkPort {
    /// On the host's side.
    pub interface: String,
    /// The device, without its arguments.
    pub name: String,
    pub state: DpdkDevice,
}

/// What can be told of a device without taking it over.
#[derive(Clone, Debug)]
pub enum DpdkDevice {
    /// An interface of the kernel's, if it is there.
    Interface { name: String, found: Option<Device> },
    /// A network card, if it is there, with the driver it is bound to.
    Card(Option<Option<String>>),
    /// Neither.
    Other,
}

#[derive(Clone, Copy, Debug)]
pub struct Clock {
    /// Seconds since 1970.
    pub unix: u64,
    pub synchronised: bool,
}

/// The place for what is to outlive the daemon.
#[derive(Clone, Debug)]
pub enum Bpffs {
    Mounted {
        path: String,
    },
    ReadOnly {
        path: String,
        reason: String,
    },
    /// Nothing is there, so that it can be mounted.
    Missing {
        path: String,
        /// Whether this process may.
        may_mount: bool,
        /// Whether it would be seen, and stay, only as long as this process has company in its
        /// mount namespace.
        private: bool,
    },
    Occupied {
        path: String,
    },
}

/// The eBPF object was loaded, attached to nothing.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// Where it came from.
    pub object: String,
    /// Capacity of the FIB.
    pub names: u32,
    pub jitted: Option<bool>,
}

/// Pins of a switch.
#[derive(Clone, Debug)]
pub struct LeftOver {
    pub folder: String,
    pub abi: u32,
    /// Whether its daemon lives.
    pub daemon: bool,
    /// Whether it is in this network namespace.
    pub here: bool,
}

#[derive(Clone, Debug)]
pub struct UdpFacts {
    pub address: SocketAddr,
    pub state: PortState,
    pub zero_checksum_v6: Result<(), String>,
}

#[derive(Clone, Debug)]
pub enum PortState {
    Free,
    Daemon,
    /// By whom, if that can be known.
    Taken(Option<String>),
    Refused(String),
}

#[derive(Clone, Debug)]
pub struct Interface {
    pub device: Device,
    pub offloads: Offloads,
    /// None before Linux 6.3.
    pub features: Option<Features>,
    /// What XDP would disturb there, if it is not named.
    pub disturbed: Option<String>,
    /// Of the program on it, if there is one.
    pub owner: Owner,
    /// Whether VLAN interfaces are on it.
    pub has_vlans: bool,
}

/// Whose a program is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Owner {
    Switch,
    Foreign,
}
