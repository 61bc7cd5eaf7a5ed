//! How large the frames sent on a link may be, when links further on take less than the first: learnt from the errors that frames
//! drew. Written by the receiving thread, read by publishers.

use std::sync::atomic::{AtomicU32, Ordering};

use gdp_wire::{ErrorCode, Header};

use crate::link::MIN_MTU;

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
            tracing::info!(mtu, name = %format_args!("{:#}", error.destination), "frames were too big for a link further on; sending smaller ones");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_too_big_lowers_it_and_nothing_raises_it() {
        let size = FrameSize::default();
        let learn = |code: ErrorCode, mtu: u32| {
            let mut error = Header::default();
            error.become_error(code, mtu);
            size.learn(code, &error);
            size.get()
        };
        assert_eq!(learn(ErrorCode::NoRoute, 0), u32::MAX);
        assert_eq!(learn(ErrorCode::TooBig, 1452), 1452);
        assert_eq!(learn(ErrorCode::TooBig, 1472), 1452);
        assert_eq!(learn(ErrorCode::TooBig, 7), 1452, "not an MTU");
        assert_eq!(learn(ErrorCode::NoRoute, 1000), 1452);
        assert_eq!(learn(ErrorCode::TooBig, 1200), 1200);
    }
}
