//! Errors of loading, attaching and updating the kernel plane.

use crate::kernel_errors;
use crate::kernel_version::KernelVersion;
use crate::object::{BuiltWithoutXdp, Object};
use crate::pins::PinsError;
use aya::EbpfError;
use aya::maps::MapError;
use aya::pin::PinError;
use aya::programs::ProgramError;
use aya::programs::links::LinkError;
use gdp_wire::table::MAX_PORTS;
use std::path::PathBuf;

/// Reasons why the XDP programs cannot be used at all.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    #[error(
        "this process lacks {}; run it as root, or grant it these with `setcap` or AmbientCapabilities= of \
         systemd", .0.join(", ")
    )]
    NotPermitted(Vec<&'static str>),
    #[error("the kernel is {0}, and the XDP programs need {FLOOR} or later")]
    OldKernel(KernelVersion),
    #[error(transparent)]
    NoObject(#[from] BuiltWithoutXdp),
    #[error("{object}: {}", kernel_errors::load(source))]
    Object { object: Object, source: Box<EbpfError> },
    #[error(
        "{object}: it has no {what} `{name}`; it belongs to another version: `cargo xtask build` makes the right one"
    )]
    Mismatch { object: Object, what: &'static str, name: &'static str },
    #[error("{object}: {}", kernel_errors::program(source))]
    Program { object: Object, source: Box<ProgramError> },
    #[error("{object}: map `{map}`: {source}")]
    Map { object: Object, map: &'static str, source: MapError },
    #[error("cannot map the counts and windows of links into memory: {0}")]
    LinkMemory(std::io::Error),
    #[error("the groups that an earlier daemon left: {0}")]
    Groups(#[from] OpenError),
    #[error(transparent)]
    Fib(#[from] UpdateError),
    #[error("{object}: {source}")]
    Read { object: Object, source: std::io::Error },
    #[error("{object}: {source}")]
    Parse { object: Object, source: aya_obj::ParseError },
    #[error(transparent)]
    Pins(#[from] PinsError),
}

/// The program could not be attached to an interface, or detached from it.
#[derive(Debug, thiserror::Error)]
pub enum AttachError {
    #[error(transparent)]
    Program(#[from] ProgramError),
    #[error("the program cannot be made to outlive the daemon: {0}")]
    Pin(#[from] PinError),
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error("{}: {source}", path.display())]
    Unpin { path: PathBuf, source: std::io::Error },
}

/// The kernel refused a write to a BPF map.
#[derive(Debug, thiserror::Error)]
pub enum UpdateError {
    #[error("the FIB is full ({capacity} names): set `fib_capacity` higher")]
    FibFull { capacity: u32 },
    #[error("no memory for a FIB of {names} names ({source}): set `fib_capacity` lower")]
    FibMemory { names: u32, source: std::io::Error },
    #[error("{}: the FIB cannot be made to outlive the daemon: {source}", path.display())]
    FibPin { path: PathBuf, source: std::io::Error },
    #[error(
        "the FIB is full ({capacity} second and further writers of a name at one switch): set `fib_capacity` higher"
    )]
    PermitsFull { capacity: u32 },
    #[error("XDP runs on {MAX_PORTS} interfaces already, the most it does")]
    PortsFull,
    #[error("port {port} cannot lead to interface {ifindex}: {source}")]
    Port { port: u32, ifindex: u32, source: aya::maps::xdp::XdpMapError },
    #[error("BPF map {map}: {source}")]
    Map { map: &'static str, source: MapError },
}

/// The oldest kernel that the programs support.
pub const FLOOR: KernelVersion = KernelVersion(5, 15);

/// The state of an earlier daemon cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    #[error(transparent)]
    Map(#[from] MapError),
    #[error(transparent)]
    Update(#[from] UpdateError),
    #[error(transparent)]
    Pins(#[from] PinsError),
}
