//! Where the frame lies in a packet.

/// Where the frame lies in a packet.
#[derive(Clone, Copy)]
pub struct FrameLocation {
    /// Bytes in front of it.
    pub at: usize,
    /// Bytes there are of it, and perhaps of padding behind it.
    pub available: usize,
    /// Whether it may also be QUIC.
    pub over_udp: bool,
}
