//! Egress of a loop's packets by one port.

use crate::mbuf::{Burst, Mbuf};
use crate::port::Send;
use parking_lot::Mutex;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Egress of a loop's packets by one port.
pub struct TxLane {
    pub send: Arc<Mutex<Send>>,
    pub gathers: bool,
    pub leaving: Burst,
    /// Packets that the device did not accept.
    pub lost: Arc<AtomicU64>,
}

impl TxLane {
    /// Creates a lane. `lost`: counter of packets that the device did not accept.
    pub fn new(send: Arc<Mutex<Send>>, gathers: bool, lost: Arc<AtomicU64>) -> Self {
        Self { send, gathers, leaving: Burst::new(), lost }
    }

    pub fn send(&mut self, mbuf: Mbuf) {
        if self.leaving.is_full() {
            self.flush();
        }
        // The burst has room after the flush.
        let _ = self.leaving.push(mbuf);
    }

    pub fn flush(&mut self) {
        if self.leaving.is_empty() {
            return;
        }
        let lost = self.send.lock().send(&mut self.leaving);
        if lost > 0 {
            self.lost.fetch_add(lost as u64, Ordering::Relaxed);
        }
    }
}
