//! How the data planes are set up, and why that fails.

use std::path::PathBuf;

use gdp_wire::Name;

use crate::dpdk::{DpdkConfig, DpdkPlaneError};
use crate::kernel_failures::{LoadError, UpdateError};
use crate::pins::PinsError;

/// Names the FIB can hold unless configured otherwise. The kernel's table begins with room for 1024
/// names and doubles as names come: 128 to 256 B of kernel memory each.
pub const FIB_CAPACITY: u32 = 65536;

/// Which data plane the operator wants.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wanted {
    /// Native XDP, else generic XDP, else userspace; the report says which and why.
    #[default]
    Auto,
    /// XDP, or an error.
    Xdp,
    /// DPDK, or an error.
    Dpdk,
    /// Neither XDP nor DPDK.
    Userspace,
}

/// How the planes are set up.
#[derive(Clone, Debug)]
pub struct PlaneConfig {
    pub wanted: Wanted,
    /// The eBPF object, if not the one that [`crate::object::Object::find`] finds.
    pub ebpf_object: Option<PathBuf>,
    /// For the DPDK plane.
    pub dpdk: DpdkConfig,
    /// The file in which DPDK's settings of interfaces outlive a daemon that is killed, if they are
    /// to.
    pub dpdk_settings: Option<PathBuf>,
    /// Names the FIB can hold.
    pub fib_capacity: u32,
    /// Of GDP frames.
    pub ethertype: u16,
    /// Where the kernel keeps what is to outlive the daemon, if anything is.
    pub pins: Option<PinLocation>,
    /// Whether to count the frames that are lost after a redirect. What counts them sees each batch
    /// of redirected frames of the whole machine, so one switch of a machine should.
    pub count_losses: bool,
}

/// A place for the pins of a switch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PinLocation {
    pub bpffs: PathBuf,
    pub switch: Name,
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
