//! The facts that [`super::gather`] collects and [`super::examine`] judges.

use std::net::SocketAddr;

use gdp_dataplane::device::{Device, Offloads};
use gdp_dataplane::kernel_version::KernelVersion;
use gdp_dataplane::xdp_features::Features;

/// The facts of one host, in one network namespace.
#[derive(Clone, Debug)]
pub struct Facts {
    pub clock: Clock,
    pub wanted: Wanted,
    /// The facts of DPDK, if the configuration selects it.
    pub dpdk: Option<Dpdk>,
    pub kernel: KernelVersion,
    /// The capabilities that the daemon needs and this process lacks.
    pub missing_capabilities: Vec<&'static str>,
    /// Whether the kernel supports the loss counters.
    pub losses: Result<(), String>,
    /// The BPF file system. `None` if the configuration turns pinning off.
    pub bpffs: Option<Bpffs>,
    pub object: Result<Loaded, String>,
    pub left_over: Vec<LeftOver>,
    /// The UDP address. `None` if the configuration turns UDP off.
    pub udp: Option<UdpFacts>,
    /// The interfaces to run on, or the names of missing ones.
    pub interfaces: Result<Vec<Result<Interface, String>>, String>,
}

/// The data plane that the daemon would try first.
#[derive(Clone, Copy, Debug)]
pub enum Wanted {
    Xdp,
    Dpdk,
    /// The userspace plane, with the reason.
    Userspace(&'static str),
}

/// The resources of DPDK.
#[derive(Clone, Debug)]
pub struct Dpdk {
    /// Whether this build supports DPDK.
    pub built: bool,
    pub root: bool,
    /// The number of free huge pages, if the configuration wants them.
    pub huge_pages: Option<u64>,
    pub ports: Vec<DpdkPort>,
}

/// A configured port.
#[derive(Clone, Debug)]
pub struct DpdkPort {
    /// The interface on the host's side.
    pub interface: String,
    /// The device, without its arguments.
    pub name: String,
    pub state: DpdkDevice,
}

/// The state of a device that the daemon has not taken over.
#[derive(Clone, Debug)]
pub enum DpdkDevice {
    /// A kernel interface, with its state if it exists.
    Interface { name: String, found: Option<Device> },
    /// A network card. `None` if it does not exist; the inner value is its driver, if it is bound
    /// to one.
    Card(Option<Option<String>>),
    /// Another device.
    Other,
}

#[derive(Clone, Copy, Debug)]
pub struct Clock {
    /// The Unix time, in seconds.
    pub unix: u64,
    pub synchronised: bool,
}

/// The state of the BPF file system for pins.
#[derive(Clone, Debug)]
pub enum Bpffs {
    Mounted {
        path: String,
    },
    ReadOnly {
        path: String,
        reason: String,
    },
    /// Nothing is there, so the daemon can mount it.
    Missing {
        path: String,
        /// Whether this process may mount it.
        may_mount: bool,
        /// Whether this process has a mount namespace of its own. A mount would be visible only
        /// there, and end with it.
        private: bool,
    },
    Occupied {
        path: String,
    },
}

/// An eBPF object that was loaded and not attached.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// The origin of the object.
    pub object: String,
    /// The capacity of the FIB, in names.
    pub names: u32,
    pub jitted: Option<bool>,
}

/// The pins of a switch.
#[derive(Clone, Debug)]
pub struct LeftOver {
    pub folder: String,
    pub abi: u32,
    /// Whether the daemon of the switch runs.
    pub daemon: bool,
    /// Whether the pins are of this network namespace.
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
    /// The port is taken, by this program if it is known.
    Taken(Option<String>),
    Refused(String),
}

#[derive(Clone, Debug)]
pub struct Interface {
    pub device: Device,
    pub offloads: Offloads,
    /// The XDP features. `None` before Linux 6.3.
    pub features: Option<Features>,
    /// The function that XDP would disturb there, if the interface is not named.
    pub disturbed: Option<String>,
    /// The owner of the attached program, if there is one.
    pub owner: Owner,
    /// Whether VLAN interfaces are on top of it.
    pub has_vlans: bool,
}

/// The owner of an XDP program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Owner {
    Switch,
    Foreign,
}
