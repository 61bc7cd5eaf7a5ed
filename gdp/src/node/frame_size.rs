//! The frame size limit of a link, learnt from TooBig errors about links beyond the first. The
//! receiving thread writes it, publishers read it.

use std::sync::atomic::{AtomicU32, Ordering};

use gdp_wire::{ErrorCode, Header};

use gdp_link::link::MIN_MTU;

/// The limit in bytes, header and payload. It only decreases; a new link starts without a limit.
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

    /// Processes an error from the switch.
    pub fn learn(&self, code: ErrorCode, error: &Header) {
        let (mtu, _) = error.complaint();
        // No link has a smaller MTU.
        if code == ErrorCode::TooBig && mtu >= MIN_MTU && self.0.fetch_min(mtu, Ordering::Relaxed) > mtu {
            tracing::info!(mtu, name = %format_args!("{:#}", error.destination), "frames were too big for a link \
                                                      further on; sending smaller ones");
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/frame_size.rs"]
mod tests;
