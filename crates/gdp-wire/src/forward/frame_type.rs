//! The frame type in the first byte.

use crate::header::FrameType;

#[inline(always)]
pub fn frame_type(first_byte: u8) -> Option<FrameType> {
    const DATA: u8 = FrameType::Data.first_byte();
    const CONTROL: u8 = FrameType::Control.first_byte();
    const ERROR: u8 = FrameType::Error.first_byte();
    const PROBE: u8 = FrameType::Probe.first_byte();
    const ECHO: u8 = FrameType::Echo.first_byte();
    match first_byte {
        DATA => Some(FrameType::Data),
        CONTROL => Some(FrameType::Control),
        ERROR => Some(FrameType::Error),
        PROBE => Some(FrameType::Probe),
        ECHO => Some(FrameType::Echo),
        _ => None,
    }
}
