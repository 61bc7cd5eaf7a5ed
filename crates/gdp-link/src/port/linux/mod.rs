//! The sockets of a port on Linux: raw Ethernet, and UDP with two sockets at one address, with
//! segmentation offload.

mod control;
mod data;
mod discover;
pub mod ethernet;
mod host_id;
mod misdelivered;
mod route_mtu;
mod send;
mod slots;
mod sys;
mod udp;
#[cfg(test)]
#[path = "../../../tests/unit/port/linux/udp.rs"]
mod udp_tests;
mod wake;

pub use data::DataSocket;
pub use sys::{limit_unsent, set_buffers};
pub use udp::SharedUdp;
pub use wake::WakeEvent;
