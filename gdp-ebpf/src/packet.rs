//! A packet as XDP provides it: bounds checks in the form that the verifier recognises, access
//! without copying, and changes of the length.

use aya_ebpf::helpers::{bpf_xdp_adjust_head, bpf_xdp_adjust_tail, bpf_xdp_get_buff_len};
use aya_ebpf::programs::XdpContext;
use gdp_wire::Header;

use crate::opaque::opaque;

/// The part of a packet in its first buffer. Invalid after the length of the packet has changed.
#[derive(Clone, Copy)]
pub struct Packet {
    start: usize,
    /// End of the first buffer; the packet may continue in further buffers.
    end: usize,
}

impl Packet {
    #[inline(always)]
    pub fn of(context: &XdpContext) -> Self {
        Self { start: context.data(), end: context.data_end() }
    }

    /// Returns the packet from offset `at` on. The verifier need not know the offset, because all
    /// accesses then use the same pointer, which the bounds checks apply to.
    #[inline(always)]
    pub fn from(&self, at: usize) -> Self {
        Self { start: opaque(self.start + at), ..*self }
    }

    /// Returns a pointer to a `T` at offset `at`, if all of it is in the first buffer. `T` must
    /// consist of plain integers, for which any bytes are valid.
    ///
    /// The address need not be a multiple of the type's alignment. An unaligned word access is an
    /// ordinary instruction on all targets the kernel compiles this program for. Declaring the
    /// access unaligned would make the compiler assemble every word from bytes.
    #[inline(always)]
    pub fn get<T>(&self, at: usize) -> Option<*mut T> {
        let from = self.start + at;
        (from + size_of::<T>() <= self.end).then_some(from as *mut T)
    }

    /// Returns the GDP header at offset `at`, without copying it.
    #[inline(always)]
    pub fn header(&mut self, at: usize) -> Option<&mut Header> {
        // SAFETY: `get` checked the bounds, and only this program accesses the packet while it
        // runs. For the alignment see `get`.
        self.get::<Header>(at).map(|header| unsafe { &mut *header })
    }
}

/// Returns the length of the whole packet in bytes, including further buffers.
#[inline(always)]
pub fn length(context: &XdpContext) -> usize {
    // SAFETY: a helper that reads the context it is given.
    unsafe { bpf_xdp_get_buff_len(context.ctx) as usize }
}

/// Removes `bytes` bytes from the end. Returns `false` if the kernel refuses.
#[inline(always)]
pub fn cut(context: &XdpContext, bytes: usize) -> bool {
    // SAFETY: a helper on the context it is given; it checks the length.
    bytes == 0 || unsafe { bpf_xdp_adjust_tail(context.ctx, -(bytes as i32)) == 0 }
}

/// Moves the start of the packet, so that offset `from` becomes offset `to`. Returns `false` if
/// there is no room.
#[inline(always)]
pub fn shift(context: &XdpContext, from: usize, to: usize) -> bool {
    // SAFETY: as above.
    from == to || unsafe { bpf_xdp_adjust_head(context.ctx, from as i32 - to as i32) == 0 }
}
