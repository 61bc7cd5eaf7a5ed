//! Configuration and errors of the data planes.

use std::path::PathBuf;

use crate::dpdk::{DpdkConfig, DpdkPlaneError};
use crate::kernel_failures::{LoadError, UpdateError};
use crate::pins::{PinLocation, PinsError};

/// Default capacity of the FIB, in names. The kernel's table starts with room for 1024 names and
/// doubles as names are added: 128 to 256 B of kernel memory for each name.
pub const FIB_CAPACITY: u32 = 65536;

/// Data plane that the operator requested.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wanted {
    /// Native XDP, else generic XDP, else userspace. The report states the choice and the reason.
    #[default]
    Auto,
    /// XDP, or an error.
    Xdp,
    /// DPDK, or an error.
    Dpdk,
    /// Neither XDP nor DPDK.
    Userspace,
}

/// Configuration of the planes.
#[derive(Clone, Debug)]
pub struct PlaneConfig {
    pub wanted: Wanted,
    /// The eBPF object, if different from the result of [`crate::object::Object::find`].
    pub ebpf_object: Option<PathBuf>,
    /// For the DPDK plane.
    pub dpdk: DpdkConfig,
    /// File that stores DPDK's interface settings, so that they survive a daemon that is killed.
    /// `None`: not stored.
    pub dpdk_settings: Option<PathBuf>,
    /// Maximum number of names in the FIB.
    pub fib_capacity: u32,
    /// Ethertype of GDP frames.
    pub ethertype: u16,
    /// Location of the pins that outlive the daemon. `None`: no pins.
    pub pins: Option<PinLocation>,
    /// Whether to count frames lost after a redirect. The counting program sees every batch of
    /// redirected frames on the whole machine, so only one switch of a machine should count.
    pub count_losses: bool,
}

impl Default for PlaneConfig {
    fn default() -> Self {
        Self {
            wanted: Wanted::Auto,
            ebpf_object: None,
            dpdk: DpdkConfig::default(),
            dpdk_settings: None,
            fib_capacity: FIB_CAPACITY,
            ethertype: gdp_wire::ETHERTYPE,
            pins: None,
            count_losses: true,
        }
    }
}

#[derive(Debug, thiserror::Error)]
pub enum PlaneError {
    #[error("{interface}: `data_plane: xdp` was asked for, but {reason}")]
    NoXdp { interface: String, reason: String },
    #[error("`data_plane: xdp` was asked for: {0}")]
    Load(#[from] LoadError),
    #[error("`data_plane: dpdk` was asked for: {0}")]
    Dpdk(#[from] DpdkPlaneError),
    #[error(transparent)]
    Pins(#[from] PinsError),
    #[error(transparent)]
    Update(#[from] UpdateError),
    #[error("{interface}: cannot start a thread: {source}")]
    Thread { interface: String, source: std::io::Error },
}
