//! The data planes of a daemon, with a single owner. The userspace plane always runs and has the
//! full tables. Where XDP attaches, the kernel has the same entries and forwards frames before the
//! daemon sees them. DPDK can replace XDP as the fast path.
//!
//! This crate handles links and routes as `gdp-wire` defines them. It does not handle name owners,
//! certificates or the RIB. The daemon (`serve`) calls it. The kernel tests and `bench forward`
//! also call [`kernel`] and [`fib`].
//!
//! - [`data_plane`]: the traits that [`userspace_plane`], [`xdp`] and [`dpdk`] implement
//! - [`Planes`]: owner of the planes. [`dispatcher`] applies links, routes and groups to each
//!   plane, [`ports`] lists the interfaces, and [`adoption`] takes over the state of an earlier
//!   daemon
//! - [`kernel`]: the BPF maps, with [`kernel_programs`] for the programs. [`object`],
//!   [`kernel_version`] and [`kernel_errors`] support it
//! - [`dpdk`]: devices that this process drives itself, and the loops between them
//! - [`losses`]: counts frames lost after a redirect; [`kernel_types`] supports it
//! - [`capabilities`]: the Linux capabilities that this crate needs
//! - [`disturbance`]: detects interfaces on which XDP would disturb other users
//! - [`device`]: interfaces as the kernel describes them; [`xdp_features`] and [`netlink`] support
//!   it
//! - [`tables`]: the full tables, which threads read while the owner changes them
//! - [`userspace`]: the forwarding of a single frame, a pure function. [`forwarder`] has the
//!   threads and sockets around it
//! - [`fib`]: the names in the kernel. [`resizable_table`] grows this table and the full tables
//! - [`groups`]: the links that receive copies of a frame. [`kernel_groups`] and [`group_slots`]
//!   are the kernel's side of them
//! - [`link_memory`]: state that the two planes share. This state and the FIB are [`mapping`]s
//! - [`queues`]: interfaces with frames waiting to be sent
//! - [`notices`]: frames from neighbours addressed to this node
//! - [`host_pair`]: the interfaces between the switch and the endpoints on its own host
//! - [`udp`]: the addresses and interfaces that carry links over UDP
//! - [`tally`]: counters for each link and each name
//! - [`pins`]: state that remains in the kernel when the daemon ends
// Both macros panic if stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod adoption;
mod attach_mode;
pub mod capabilities;
mod config;
mod data_plane;
pub mod device;
mod dispatcher;
pub mod disturbance;
pub mod dpdk;
pub mod fib;
pub mod forwarder;
mod forwarder_state;
pub mod group_slots;
pub mod groups;
pub mod host_pair;
mod interface_plane;
pub mod kernel;
pub mod kernel_errors;
pub mod kernel_failures;
pub mod kernel_groups;
mod kernel_programs;
pub mod kernel_types;
pub mod kernel_version;
pub mod link_memory;
pub mod losses;
mod map_update;
mod mapping;
pub mod netlink;
pub mod notices;
pub mod object;
pub mod pins;
mod planes;
mod ports;
pub mod queues;
mod resizable_table;
mod route;
pub mod tables;
pub mod tally;
pub mod udp;
pub mod userspace;
mod userspace_plane;
mod verified;
mod xdp;
pub mod xdp_features;

pub use adoption::Left;
pub use config::{FIB_CAPACITY, PlaneConfig, PlaneError, Wanted};
pub use interface_plane::{InterfacePlane, SUPPORTED};
pub use pins::PinLocation;
pub use planes::Planes;
pub use route::PlaneRoute;
pub use tally::LinkCounters;
