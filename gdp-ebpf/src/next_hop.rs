//! Where the kernel's routing table leads for a link over UDP: an interface, and the MAC addresses
//! of the neighbour there and of the interface. Asked before a frame is taken, so that one for
//! which there is no answer (no route, a neighbour that is yet to be resolved, an interface that
//! takes no redirected frames) is left, untouched, to the host: the daemon's socket then sends it,
//! the kernel resolves the neighbour for that, and later frames find it.

use aya_ebpf::bindings::bpf_fib_lookup as Lookup;
use aya_ebpf::helpers::bpf_fib_lookup;
use aya_ebpf::programs::XdpContext;
use gdp_wire::packet::UDP;
use gdp_wire::{Carrier, LinkEntry};

use crate::ports;

/// The question's family for IPv4, and for IPv6.
const AF_INET: u8 = 2;
const AF_INET6: u8 = 10;

/// `lo`, in every network namespace. Asked as if from there, the table answers as it does for what
/// the host itself sends; the kernel wants forwarding enabled on that interface, which the daemon
/// sees to.
const LOOPBACK: u32 = 1;

/// Not 0: also programs in device maps can ask. User space replaces the value before the programs
/// are loaded. Before Linux 6.12 they run without the interface that a packet came by, from which
/// the kernel takes the network namespace: to ask there would crash it.
#[unsafe(no_mangle)]
static ASKS_AT_EGRESS: u32 = 0;

/// Whether what leaves can be asked for where it does.
#[inline(always)]
pub fn asks_at_egress() -> bool {
    // SAFETY: a static; user space has replaced its value, which the compiler must not take for
    // known.
    unsafe { (&raw const ASKS_AT_EGRESS).read_volatile() != 0 }
}

/// Where a frame leaves, and between which stations it goes there.
#[derive(Clone, Copy, Default)]
pub struct NextHop {
    /// The interface.
    pub port: u32,
    /// The neighbour's MAC address, if the routing table was asked.
    pub destination: [u16; 3],
    /// The interface's MAC address, likewise.
    pub source: [u16; 3],
}

/// Words of a question.
const WORDS: usize = size_of::<Lookup>() / size_of::<u64>();

const _: () = assert!(WORDS * size_of::<u64>() == size_of::<Lookup>() && align_of::<Lookup>() <= align_of::<u64>());

/// Asks for a frame of `length` bytes; `false` if it cannot be sent. A function of its own also in
/// the kernel: it is asked in several places, and inlined the compiler spills a register there that
/// holds nothing, which the verifier refuses.
#[inline(never)]
pub fn look_up(context: &XdpContext, link: &LinkEntry, length: usize, hop: &mut NextHop) -> bool {
    let carrier = &link.carrier;
    // The kernel wants all of it written before anything is read. A zero that the compiler knows
    // becomes a call of a function that writes byte by byte.
    let mut words = [core::hint::black_box(0u64); WORDS];
    let lookup: *mut Lookup = words.as_mut_ptr().cast();
    // SAFETY: the function's own memory, as large and as aligned as a question, in which any bytes
    // are one. The helper writes within the size it is given. A MAC address is six bytes at an even
    // address.
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
