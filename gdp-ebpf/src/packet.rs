//! A packet as XDP hands it over: bounds checks, once, where the verifier sees them, and access in place.

use aya_ebpf::helpers::{bpf_xdp_adjust_tail, bpf_xdp_get_buff_len};
use aya_ebpf::programs::XdpContext;
use gdp_wire::{Header, LinkEntry};

const ETHERNET_LEN: usize = 14;

/// The first bytes of an Ethernet frame, as words of the alignment they have.
#[repr(C)]
struct Ethernet {
    destination: [u16; 3],
    source: [u16; 3],
    ethertype: u16,
}

const _: () = assert!(size_of::<Ethernet>() == ETHERNET_LEN);

/// A packet that is at least an Ethernet header long.
pub struct Packet {
    start: usize,
    /// End of what can be read here; the packet may go on in further buffers.
    end: usize,
    /// Bytes of the whole packet.
    length: usize,
}

impl Packet {
    #[inline(always)]
    pub fn parse(context: &XdpContext, length: usize) -> Option<Self> {
        let (start, end) = (context.data(), context.data_end());
        (start + ETHERNET_LEN <= end).then_some(Self { start, end, length })
    }

    /// In host order.
    #[inline(always)]
    pub fn ethertype(&self) -> u16 {
        // SAFETY: `parse` checked the bounds.
        u16::from_be(unsafe { (*self.ethernet()).ethertype })
    }

    #[inline(always)]
    pub fn first_byte(&self) -> Option<u8> {
        let at = self.start + ETHERNET_LEN;
        // SAFETY: the bounds are checked in the condition.
        (at < self.end).then(|| unsafe { *(at as *const u8) })
    }

    /// Bytes behind the Ethernet header.
    #[inline(always)]
    pub fn frame_length(&self) -> usize {
        self.length - ETHERNET_LEN
    }

    /// The GDP header, in place.
    #[inline(always)]
    pub fn header(&mut self) -> Option<&mut Header> {
        let at = self.start + ETHERNET_LEN;
        // SAFETY: the bounds are checked in the condition, and the packet is this program's alone while it runs. The
        // address is a multiple of 2 only: in the machine code of all targets the kernel compiles this for, an
        // unaligned word access is an ordinary one, whereas telling the compiler so makes it build every word from bytes.
        (at + Header::LEN <= self.end).then(|| unsafe { &mut *(at as *mut Header) })
    }

    /// Writes the addresses of `link` into the Ethernet header.
    #[inline(always)]
    pub fn address(&mut self, link: &LinkEntry) {
        let mut i = 0;
        while i < 3 {
            // SAFETY: `parse` checked the bounds. Word by word, because a copy of six bytes becomes a function call.
            unsafe {
                (*self.ethernet()).destination[i] = link.carrier.peer_mac[i];
                (*self.ethernet()).source[i] = link.carrier.local_mac[i];
            }
            i += 1;
        }
    }

    #[inline(always)]
    fn ethernet(&self) -> *mut Ethernet {
        self.start as *mut Ethernet
    }
}

/// Bytes of the whole packet, further buffers included.
#[inline(always)]
pub fn length(context: &XdpContext) -> usize {
    // SAFETY: a helper that reads the context it is given.
    unsafe { bpf_xdp_get_buff_len(context.ctx) as usize }
}

/// Takes so many bytes off the end; `false` if the kernel does not. References into the packet are void after.
#[inline(always)]
pub fn cut(context: &XdpContext, bytes: usize) -> bool {
    // SAFETY: a helper on the context it is given; it checks the length.
    bytes == 0 || unsafe { bpf_xdp_adjust_tail(context.ctx, -(bytes as i32)) == 0 }
}
