//! The DPDK data plane: devices that this process drives itself, and the loops that forward frames
//! between them.
//!
//! This crate does not depend on the daemon. The caller provides the tables for decisions
//! (`gdp_wire::forward::decide`). Packets that are not for this plane go to the host. The modules
//! from the bottom up:
//!
//! - [`sys`]: DPDK bindings from bindgen, the only module with foreign names
//! - [`eal`]: initialization of DPDK; [`mbuf`]: packets and their pools; [`port`]: devices and
//!   their queues
//! - [`carrier`]: encapsulation of frames; [`siphash`]: hop tags for many frames at once;
//!   [`local`]: criteria for packets to this switch
//! - [`view`]: the tables that a loop uses; [`batch`]: the tables for the frames of one batch
//! - [`forwarding`]: processing of packets that arrive together; [`worker`]: the loop around it;
//!   [`idle`]: its sleeps
//! - [`tap`] and [`host`]: packets to and from the kernel
//! - [`switch`]: the loops and ports of a switch
// Both macros panic if stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod batch;
pub mod carrier;
pub mod eal;
mod error;
pub mod forwarding;
mod host;
pub mod idle;
mod lane;
pub mod local;
pub mod mbuf;
pub mod port;
pub mod siphash;
pub mod switch;
mod sys;
mod tap;
pub mod view;
mod worker;

pub use eal::{Eal, EalConfig, EalError, Memory};
pub use error::DpdkError;
pub use idle::Idle;
pub use mbuf::{Burst, Mbuf, Pool};
pub use port::{Port, PortConfig, PortCounters};
pub use switch::{Switch, SwitchConfig, SwitchError};
