//! The UDP checksum of a frame, for neighbours whose kernel coalesces only datagrams with a
//! checksum ([`Carrier::CHECKSUM`]).

use aya_ebpf::helpers::generated::bpf_csum_diff;
use aya_ebpf::programs::XdpContext;
use gdp_wire::Carrier;
use gdp_wire::packet::UDP;

use crate::carrier::udp4::Udp;
use crate::packet::Packet;

/// Maximum number of bytes that kernels before 6.13 sum in one call.
const BLOCK: usize = 512;

/// Maximum number of full blocks: frames of up to 9 kB.
const MOST_BLOCKS: usize = 18;

/// Mask that bounds a length for the verifier: 14 bits.
const LENGTHS: usize = 0x3fff;

/// Writes the checksum of a datagram of `bytes` bytes into the UDP header at offset `at`. Writes
/// none if the datagram is too long or not entirely in the packet's first buffer.
#[inline(always)]
pub fn write(context: &XdpContext, carrier: &Carrier, at: usize, bytes: usize) {
    if bytes >= (MOST_BLOCKS + 1) * BLOCK {
        return;
    }
    let sum = sum(context.data() + at, context.data_end(), bytes, pseudo_header(carrier, bytes));
    if let (Some(sum), Some(udp)) = (sum, Packet::of(context).get::<Udp>(at)) {
        // Zero would mean that there is no checksum (RFC 768).
        let checksum = if sum == 0xffff { sum } else { !sum };
        // SAFETY: `get` checked the bounds.
        unsafe { (*udp).checksum = checksum };
    }
}

/// Returns the sum of the pseudo header of RFC 768 or RFC 8200. Both have the same sum, because the
/// address words that IPv4 does not use are zero.
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

/// Returns the folded ones' complement sum of `seed` and `bytes` bytes from `start` on. Returns
/// `None` if the bytes extend beyond `end`.
#[inline(always)]
fn sum(start: usize, end: usize, bytes: usize, seed: u32) -> Option<u16> {
    let mut sum = seed;
    let mut block = 0;
    while block < MOST_BLOCKS && (block + 1) * BLOCK <= bytes {
        sum = add(start + block * BLOCK, end, BLOCK, sum)?;
        block += 1;
    }
    // A mask of the length alone gives the offset of each part. The verifier therefore knows the
    // bounds, whichever parts precede it.
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

/// Adds `bytes` bytes, a multiple of 4, to a sum.
#[inline(always)]
fn add(at: usize, end: usize, bytes: usize, sum: u32) -> Option<u32> {
    if at + bytes > end {
        return None;
    }
    // SAFETY: the helper reads only bytes within the bounds checked above.
    Some(unsafe { bpf_csum_diff(core::ptr::null_mut(), 0, at as *mut u32, bytes as u32, sum) } as u32)
}
