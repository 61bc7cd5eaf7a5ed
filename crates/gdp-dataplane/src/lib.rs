//! The data planes of a daemon behind one owner. The userspace plane always runs and holds the full
//! tables; where XDP attaches, the kernel holds the same entries and forwards before the daemon
//! sees a frame. Instead of XDP, DPDK may be before it.
//!
//! Knows links and routes as `gdp-wire` has them, nothing of names' owners, certificates or the
//! RIB. Called by the daemon (`serve`); [`kernel`] and [`fib`] also by the kernel tests and `bench
//! forward`.
//!
//! - [`data_plane`]: what the planes have in common; implemented by [`userspace_plane`], [`xdp`]
//!   and [`dpdk`]
//! - [`Planes`]: their owner. [`dispatcher`] applies links, routes and groups to each, [`ports`]
//!   are the interfaces, [`adoption`] takes over what an earlier daemon left
//! - [`kernel`]: the BPF maps, and [`kernel_programs`]; [`object`], [`kernel_version`] and
//!   [`kernel_errors`] serve it
//! - [`dpdk`]: devices that this process drives by itself, and the loops between them
//! - [`losses`]: what is lost after a redirect; [`kernel_types`] serves it
//! - [`capabilities`]: which this needs of Linux's
//! - [`disturbance`]: on which interfaces XDP is in somebody's way
//! - [`device`]: interfaces as the kernel describes them; [`xdp_features`] and [`netlink`] serve it
//! - [`tables`]: the full tables, which threads read while they change
//! - [`userspace`]: what happens to one frame, pure; [`forwarder`]: the threads and sockets around
//!   it
//! - [`fib`]: the names in the kernel; [`resizable_table`]: room for more of them, there and in the
//!   full tables
//! - [`groups`]: which links take copies of a frame; [`kernel_groups`] and [`group_slots`]: what
//!   the kernel holds of them
//! - [`link_memory`]: what the two planes share; this and the FIB are [`mapping`]s
//! - [`queues`]: where frames wait to be sent
//! - [`notices`]: what neighbours say to this node itself
//! - [`host_pair`]: the interfaces between the switch and endpoints on its own host
//! - [`udp`]: which addresses and interfaces carry links over UDP
//! - [`tally`]: what is counted by link and by name
//! - [`pins`]: what stays in the kernel when the daemon dies
// They panic where stdout or stderr cannot be written.
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
pub use config::{FIB_CAPACITY, PinLocation, PlaneConfig, PlaneError, Wanted};
pub use interface_plane::{InterfacePlane, SUPPORTED};
pub use planes::Planes;
pub use route::PlaneRoute;
