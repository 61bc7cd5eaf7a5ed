//! A packet as XDP hands it over: bounds checks where the verifier sees them, access in place, and
//! changes of its length.

use aya_ebpf::helpers::{bpf_xdp_adjust_head, bpf_xdp_adjust_tail, bpf_xdp_get_buff_len};
use aya_ebpf::programs::XdpContext;
use gdp_wire::Header;

/// What there is of a packet here. Void after its length has changed.
#[derive(Clone, Copy)]
pub struct Packet {
    start: usize,
    /// End of what can be read here; the packet may go on in further buffers.
    end: usize,
}

impl Packet {
    #[inline(always)]
    pub fn of(context: &XdpContext) -> Self {
        Self { start: context.data(), end: context.data_end() }
    }

    /// What lies `at` bytes behind the start, if all of it is here. `T`: plain integers, for which
    /// any bytes are a value.
    ///
    /// The address need not be a multiple of the type's alignment: in the machine code of all
    /// targets the kernel compiles this for, an unaligned word access is an ordinary one, whereas
    /// telling the compiler so makes it build every word from bytes.
    #[inline(always)]
    pub fn get<T>(&self, at: usize) -> Option<*mut T> {
        let from = self.start + at;
        (from + size_of::<T>() <= self.end).then_some(from as *mut T)
    }

    /// The GDP header `at` bytes behind the start, in place.
    #[inline(always)]
    pub fn header(&mut self, at: usize) -> Option<&mut Header> {
        // SAFETY: `get` checked the bounds, and the packet is this program's alone while it runs;
        // for the alignment see there.
        self.get::<Header>(at).map(|header| unsafe { &mut *header })
    }
}

/// Bytes of the whole packet, further buffers included.
#[inline(always)]
pub fn length(context: &XdpContext) -> usize {
    // SAFETY: a helper that reads the context it is given.
    unsafe { bpf_xdp_get_buff_len(context.ctx) as usize }
}

/// Takes so many bytes off the end; `false` if the kernel does not.
#[inline(always)]
pub fn cut(context: &XdpContext, bytes: usize) -> bool {
    // SAFETY: a helper on the context it is given; it checks the length.
    bytes == 0 || unsafe { bpf_xdp_adjust_tail(context.ctx, -(bytes as i32)) == 0 }
}

/// Moves the start so that what was `from` bytes behind it is `to` bytes behind it; `false` if
/// there is no room.
#[inline(always)]
pub fn shift(context: &XdpContext, from: usize, to: usize) -> bool {
    // SAFETY: as above.
    from == to || unsafe { bpf_xdp_adjust_head(context.ctx, from as i32 - to as i32) == 0 }
}
