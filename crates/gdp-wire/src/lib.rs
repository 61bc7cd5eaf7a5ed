//! The byte-level agreement of all parts of the Global Data Plane: names, frame headers, table
//! layouts of a data plane, and the forwarding decision.
//!
//! `no_std`, no allocation, no I/O, no clock. The eBPF program, the userspace plane and endpoints
//! all call [`forward::decide`] or [`forward::accept`]. None of them has forwarding rules of its
//! own.
#![cfg_attr(not(test), no_std)]

#[cfg(feature = "schemars")]
extern crate alloc;

pub mod counter;
pub mod fetch;
pub mod flat;
pub mod forward;
pub mod header;
pub mod hop;
pub mod losses;
mod name;
pub mod packet;
pub mod replay;
pub mod siphash;
pub mod table;
pub mod tables;

pub use counter::Counter;
pub use header::{ControlHeader, ErrorCode, FrameType, Header};
pub use name::{Name, ParseNameError};
pub use table::{Carrier, FibEntry, GroupSlot, LinkEntry, LinkRole, LocalAddress, Permit, SwitchConfig, Vlan};

/// Ethertype of GDP frames carried directly on Ethernet: IEEE 802 local experimental 1.
pub const ETHERTYPE: u16 = 0x88B5;

/// UDP port that GDP frames and QUIC share.
pub const UDP_PORT: u16 = 31415;

/// Bytes of a datagram that every path supports, as QUIC assumes (RFC 9000, section 14).
pub const SMALLEST_PATH: u16 = 1200;
