//! How large the frames sent on a link may be, when links further on take less than the first:
//! learnt from the errors that frames drew. Written by the receiving thread, read by publishers.

use std::sync::atomic::{AtomicU32, Ordering};

use gdp_wire::{ErrorCode, Header};

use gdp_link::link::MIN_MTU;

/// In bytes, header and payload. Only ever falls: a new link begins anew.
#[derive(Debug)]
pub struct FrameSize(AtomicU32);

impl Default for FrameSize {
    fn default() -> Self {
        Self(AtomicU32::new(u32::MAX))
    }
}

impl FrameSize {
    pub fn get(&self) -> u32 {
        self.0.load(Ordering::Relaxed)
    }

    /// Takes note of an error that the switch sent.
    pub fn learn(&self, code: ErrorCode, error: &Header) {
        let (mtu, _) = error.complaint();
        // No link has a smaller one.
        if code == ErrorCode::TooBig && mtu >= MIN_MTU && self.0.fetch_min(mtu, Ordering::Relaxed) > mtu {
            tracing::info!(mtu, name = %format_args!("{:#}", error.destination), "frames were too big for a link \
                                                      further on; sending smaller ones");
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/frame_size.rs"]
mod tests;
