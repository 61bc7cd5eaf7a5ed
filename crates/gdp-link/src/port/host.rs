//! Direct delivery between a switch and endpoints on the same host and in the same network
//! namespace.
//!
//! The daemon of a switch creates a pair of interfaces for such endpoints. One end has the switch's
//! XDP program attached. Their data frames pass through the pair instead of the daemon. The hellos
//! of a link (`crate::link::hello`) carry the parameters that an endpoint needs. QUIC continues to
//! use the dialled address.

use std::net::Ipv4Addr;
use std::sync::Arc;

use parking_lot::Mutex;

/// The addresses of a switch and its host on the interface pair between them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostPair {
    /// The address that endpoints send frames to. It is link-local and no address of the host: the
    /// kernel routes it to the host's end of the pair.
    pub switch_ip: Ipv4Addr,
    /// The MAC address of the end with the XDP program.
    pub switch_mac: [u8; 6],
    /// The address that frames for endpoints are sent to, at each endpoint's port.
    pub host_ip: Ipv4Addr,
    pub host_mac: [u8; 6],
    /// Largest data frame that fits the pair, in bytes.
    pub mtu: u32,
}

/// A port's current interface pair, if any. Clones share it.
#[derive(Clone, Default)]
pub(crate) struct CurrentPair(Arc<Mutex<Option<HostPair>>>);

impl CurrentPair {
    pub fn get(&self) -> Option<HostPair> {
        *self.0.lock()
    }

    pub fn set(&self, pair: Option<HostPair>) {
        *self.0.lock() = pair;
    }
}
