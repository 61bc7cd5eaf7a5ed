//! Where a loop's packets leave by a port.

use crate::mbuf::{Burst, Mbuf};
use crate::port::Send;
use parking_lot::Mutex;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Where a loop's packets leave by a port.
pub struct TxLane {
    pub send: Arc<Mutex<Send>>,
    pub gathers: bool,
    pub leaving: Burst,
    /// What the device did not take.
    pub lost: Arc<AtomicU64>,
}

impl TxLane {
    /// `lost`: where it counts what the device did not take.
    pub fn new(send: Arc<Mutex<Send>>, gathers: bool, lost: Arc<AtomicU64>) -> Self {
        Self { send, gathers, leaving: Burst::new(), lost }
    }

    pub fn send(&mut self, mbuf: Mbuf) {
        if self.leaving.is_full() {
            self.flush();
        }
        // There is room now.
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
