//! Looks up the next hop of a link over UDP in the kernel's routing table. A next hop consists of
//! an interface and the MAC addresses of the neighbour and the interface. The lookup precedes the
//! decision to take a frame. A frame without a next hop (no route, an unresolved neighbour, an
//! interface that takes no redirected frames) goes to the host unchanged. The daemon's socket then
//! sends the frame, for which the kernel resolves the neighbour. Lookups for later frames succeed.

use aya_ebpf::bindings::bpf_fib_lookup as Lookup;
use aya_ebpf::helpers::bpf_fib_lookup;
use aya_ebpf::programs::XdpContext;
use gdp_wire::packet::UDP;
use gdp_wire::{Carrier, LinkEntry};

use crate::opaque::zero;
use crate::ports;

/// The address families of a lookup, for IPv4 and for IPv6.
const AF_INET: u8 = 2;
const AF_INET6: u8 = 10;

/// `lo`, in every network namespace. With this ingress interface, the kernel routes as for packets
/// of the host itself. The kernel requires forwarding enabled on the interface, which the daemon
/// ensures.
const LOOPBACK: u32 = 1;

/// Not 0 if programs in device maps may also look up a next hop. User space replaces the value
/// before the programs are loaded. Before Linux 6.12, these programs run without the ingress
/// interface, from which the kernel takes the network namespace. A lookup there would crash the
/// kernel.
#[unsafe(no_mangle)]
static ASKS_AT_EGRESS: u32 = 0;

/// Returns whether the egress program may look up a next hop.
#[inline(always)]
pub fn asks_at_egress() -> bool {
    // SAFETY: a static. User space has replaced its value, so the compiler must not assume the
    // initial one.
    unsafe { (&raw const ASKS_AT_EGRESS).read_volatile() != 0 }
}

/// The egress interface of a frame, and the MAC addresses for it.
#[derive(Clone, Copy)]
#[repr(C, align(8))]
pub struct NextHop {
    /// The interface.
    pub port: u32,
    /// The neighbour's MAC address, if the routing table was consulted.
    pub destination: [u16; 3],
    /// The interface's MAC address, under the same condition.
    pub source: [u16; 3],
}

impl Default for NextHop {
    #[inline(always)]
    fn default() -> Self {
        // SAFETY: plain integers, for which any bytes are valid.
        unsafe { core::mem::transmute([zero(); size_of::<Self>() / 8]) }
    }
}

/// Words of the lookup structure.
const WORDS: usize = size_of::<Lookup>() / size_of::<u64>();

const _: () = assert!(WORDS * size_of::<u64>() == size_of::<Lookup>() && align_of::<Lookup>() <= align_of::<u64>());

/// Looks up the next hop for a frame of `length` bytes. Returns `false` if the frame cannot be
/// sent. Not inlined, also in the kernel: inlined at its several call sites, the compiler spills an
/// uninitialised register, which the verifier rejects.
#[inline(never)]
pub fn look_up(context: &XdpContext, link: &LinkEntry, length: usize, hop: &mut NextHop) -> bool {
    let carrier = &link.carrier;
    // The verifier requires the whole structure to be written before it is read.
    let mut words = [zero(); WORDS];
    let lookup: *mut Lookup = words.as_mut_ptr().cast();
    // SAFETY: the function's own memory, with the size and alignment of the structure, for which
    // any bytes are valid. The helper writes within the size it is given. A MAC address is six
    // bytes at an even address.
    unsafe {
        (*lookup).l4_protocol = UDP;
        (*lookup).sport = carrier.local_port;
        (*lookup).dport = carrier.peer_port;
        (*lookup).ifindex = LOOPBACK;
        if carrier.kind == Carrier::UDP6 {
            (*lookup).family = AF_INET6;
            (*lookup).__bindgen_anon_1.tot_len = (length + 48) as u16;
            let mut i = 0;
            while i < 4 {
                (*lookup).__bindgen_anon_3.ipv6_src[i] = carrier.local_ip[i];
                (*lookup).__bindgen_anon_4.ipv6_dst[i] = carrier.peer_ip[i];
                i += 1;
            }
        } else {
            (*lookup).family = AF_INET;
            (*lookup).__bindgen_anon_1.tot_len = (length + 28) as u16;
            (*lookup).__bindgen_anon_3.ipv4_src = carrier.local_ip[0];
            (*lookup).__bindgen_anon_4.ipv4_dst = carrier.peer_ip[0];
        }
        let answer = bpf_fib_lookup(context.ctx.cast(), lookup, size_of::<Lookup>() as i32, 0);
        hop.port = (*lookup).ifindex;
        hop.destination = (&raw const (*lookup).dmac).cast::<[u16; 3]>().read();
        hop.source = (&raw const (*lookup).smac).cast::<[u16; 3]>().read();
        answer == 0 && ports::is_there(hop.port)
    }
}
