//! The UDP checksum of a frame, for neighbours whose kernel joins datagrams only if they have one
//! ([`Carrier::CHECKSUM`]).

use aya_ebpf::helpers::generated::bpf_csum_diff;
use aya_ebpf::programs::XdpContext;
use gdp_wire::Carrier;
use gdp_wire::packet::UDP;

use crate::carrier::udp4::Udp;
use crate::packet::Packet;

/// What kernels before 6.13 sum up at once.
const BLOCK: usize = 512;

/// Blocks that are looked at: frames of up to 9 kB.
const MOST_BLOCKS: usize = 18;

/// All that a verifier needs to know of a length for its bounds checks: what 14 bits express.
const LENGTHS: usize = 0x3fff;

/// Writes the checksum of a datagram of `bytes` bytes into its UDP header, `at` bytes behind the
/// start. Writes none if the datagram is too long or not all in the packet's first buffer.
#[inline(always)]
pub fn write(context: &XdpContext, carrier: &Carrier, at: usize, bytes: usize) {
    if bytes >= (MOST_BLOCKS + 1) * BLOCK {
        return;
    }
    let sum = sum(context.data() + at, context.data_end(), bytes, pseudo_header(carrier, bytes));
    if let (Some(sum), Some(udp)) = (sum, Packet::of(context).get::<Udp>(at)) {
        // Zero would say that there is none (RFC 768).
        let checksum = if sum == 0xffff { sum } else { !sum };
        // SAFETY: `get` checked the bounds.
        unsafe { (*udp).checksum = checksum };
    }
}

/// Of RFC 768 and RFC 8200: their sums are alike, as the words of addresses that IPv4 does not have
/// are zero.
#[inline(always)]
fn pseudo_header(carrier: &Carrier, bytes: usize) -> u32 {
    let mut sum = u32::from(u16::from(UDP).to_be()) + u32::from((bytes as u16).to_be());
    let mut i = 0;
    while i < 4 {
        let (local, peer) = (carrier.local_ip[i], carrier.peer_ip[i]);
        sum += (local & 0xffff) + (local >> 16) + (peer & 0xffff) + (peer >> 16);
        i += 1;
    }
    sum
}

/// The ones' complement sum of `bytes` bytes from `start` on and `seed`, folded; `None` if not all
/// are before `end`.
#[inline(always)]
fn sum(start: usize, end: usize, bytes: usize, seed: u32) -> Option<u16> {
    let mut sum = seed;
    let mut block = 0;
    while block < MOST_BLOCKS && (block + 1) * BLOCK <= bytes {
        sum = add(start + block * BLOCK, end, BLOCK, sum)?;
        block += 1;
    }
    // Where what is left begins follows from the length alone, by a mask: so bounds are known,
    // whichever parts there were before.
    let mut part = BLOCK / 2;
    while part >= 4 {
        if bytes & part != 0 {
            sum = add(start + (bytes & (LENGTHS & !(2 * part - 1))), end, part, sum)?;
        }
        part /= 2;
    }
    let mut sum = u64::from(sum);
    if bytes & 2 != 0 {
        let at = start + (bytes & (LENGTHS & !3));
        if at + 2 > end {
            return None;
        }
        // SAFETY: the bounds were checked; for the alignment see `Packet::get`.
        sum += u64::from(unsafe { *(at as *const u16) });
    }
    if bytes & 1 != 0 {
        let at = start + (bytes & (LENGTHS & !1));
        if at + 1 > end {
            return None;
        }
        // SAFETY: the bounds were checked. The byte is the first of a word whose second is zero.
        sum += u64::from(u16::from_ne_bytes([unsafe { *(at as *const u8) }, 0]));
    }
    let sum = (sum & 0xffff) + (sum >> 16);
    let sum = (sum & 0xffff) + (sum >> 16);
    Some(((sum & 0xffff) + (sum >> 16)) as u16)
}

/// `bytes`: a multiple of 4.
#[inline(always)]
fn add(at: usize, end: usize, bytes: usize, sum: u32) -> Option<u32> {
    if at + bytes > end {
        return None;
    }
    // SAFETY: the helper reads what was checked to be there.
    Some(unsafe { bpf_csum_diff(core::ptr::null_mut(), 0, at as *mut u32, bytes as u32, sum) } as u32)
}
