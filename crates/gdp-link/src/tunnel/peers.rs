//! The peers behind a listener's loopback sockets.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::Arc;

use parking_lot::Mutex;

/// The address of each tunnel's peer, by the address of the tunnel's loopback socket. Clones share
/// the table.
#[derive(Clone, Debug, Default)]
pub struct TunnelPeers(Arc<Mutex<HashMap<SocketAddr, SocketAddr>>>);

impl TunnelPeers {
    /// Returns the peer whose datagrams come from this address.
    pub fn get(&self, local: SocketAddr) -> Option<SocketAddr> {
        self.0.lock().get(&local).copied()
    }

    pub(super) fn add(&self, local: SocketAddr, peer: SocketAddr) {
        self.0.lock().insert(local, peer);
    }

    pub(super) fn remove(&self, local: SocketAddr) {
        self.0.lock().remove(&local);
    }
}
