//! The location of a frame in a packet.

/// The location of a frame in a packet.
#[derive(Clone, Copy)]
pub struct FrameLocation {
    /// Offset of the frame in the packet, in bytes.
    pub at: usize,
    /// Bytes from the start of the frame on, possibly including padding.
    pub available: usize,
    /// Whether the payload may also be QUIC.
    pub over_udp: bool,
}
