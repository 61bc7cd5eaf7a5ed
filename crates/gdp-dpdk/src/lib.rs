//! The DPDK data plane: devices that this process drives by itself, and the loop that forwards
//! frames between them.
//!
//! Knows nothing of the daemon: it is given tables to decide by (`gdp_wire::forward::decide`), and
//! hands what is not for it to the host. The modules from the bottom up:
//!
//! - [`sys`]: DPDK as bindgen reads it; the only module whose names are not ours
//! - [`eal`]: how DPDK begins; [`mbuf`]: packets and their pools; [`port`]: devices and their
//!   queues
//! - [`carrier`]: what frames are carried in; [`siphash`]: hop tags, many at once; [`local`]: which
//!   packets are for this switch
//! - [`view`]: what a loop is given to decide by; [`batch`]: the same for the frames of one batch
//! - [`forwarding`]: what becomes of the packets that arrive together; [`worker`]: the loop around
//!   it, and [`idle`], when it sleeps
//! - [`tap`] and [`host`]: how the kernel gets what is its own, and sends
//! - [`switch`]: the loops and ports of a switch
// They panic where stdout or stderr cannot be written.
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
