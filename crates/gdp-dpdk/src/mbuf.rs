//! Packets in DPDK's memory, and the pools that they come from. An [`Mbuf`] owns its packet:
//! dropping it gives that back, so nothing is lost on any path.

use std::ffi::CString;
use std::mem::ManuallyDrop;
use std::ops::{Deref, DerefMut};
use std::ptr::NonNull;
use std::sync::Arc;
use std::sync::atomic::{AtomicU16, AtomicU32, Ordering};

use gdp_wire::fetch::fetch;

use crate::{DpdkError, Eal, sys};

/// The largest packet that fits an mbuf, in bytes: a jumbo frame.
pub const LARGEST: usize = 9216;

/// Bytes in front of a packet that arrives: what frames are dressed in on their way out takes less.
const HEADROOM: u16 = sys::RTE_PKTMBUF_HEADROOM as u16;

/// Mbufs that each thread keeps at hand, unless the pool is small; and half as many more for a
/// moment.
const CACHE: u32 = 256;
pub(crate) const CACHED: usize = CACHE as usize * 3 / 2;

/// The first fields of DPDK's `rte_mbuf`; the shim asserts that they are here.
#[repr(C)]
pub(crate) struct Raw {
    buffer: *mut u8,
    _iova: u64,
    data_offset: u16,
    references: AtomicU16,
    segments: u16,
    port: u16,
    offload_flags: u64,
    _packet_type: u32,
    packet_length: u32,
    data_length: u16,
    _unused: [u16; 6],
    buffer_length: u16,
    _pool: *mut sys::rte_mempool,
}

const _: () = assert!(size_of::<Raw>() == 64 && std::mem::offset_of!(Raw, buffer_length) == 54);

/// Where mbufs come from. Clones are the same pool, which lives as long as anything that came from
/// it.
#[derive(Clone)]
pub struct Pool(Arc<PoolInner>);

struct PoolInner {
    pool: NonNull<sys::rte_mempool>,
    size: u32,
    largest: usize,
    _eal: Eal,
}

// SAFETY: DPDK's pools are for all threads.
unsafe impl Send for PoolInner {}
// SAFETY: as above.
unsafe impl Sync for PoolInner {}

impl Pool {
    /// `size`: mbufs, each with room for a packet of `largest` bytes.
    pub fn new(eal: Eal, size: u32, largest: usize) -> Result<Self, DpdkError> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let what = || format!("a pool of {size} packets of {largest} bytes");
        let largest = largest.min(LARGEST);
        let name = format!("gdp-{}", NUMBER.fetch_add(1, Ordering::Relaxed));
        let name = CString::new(name).map_err(|_| DpdkError::new(what(), libc::EINVAL))?;
        let room = HEADROOM + largest as u16;
        let cache = CACHE.min(size / 4);
        // SAFETY: a name that lives during the call.
        let pool = unsafe { sys::gdp_pool_create(name.as_ptr(), size, cache, room) };
        let pool = NonNull::new(pool).ok_or_else(|| {
            DpdkError::last(what()).with_remedy("; give DPDK more memory (`dpdk.memory_mib`, or huge pages)")
        })?;
        Ok(Self(Arc::new(PoolInner { pool, size, largest, _eal: eal })))
    }

    /// A packet of no bytes.
    pub fn alloc(&self) -> Option<Mbuf> {
        let mut raw: *mut Raw = std::ptr::null_mut();
        // SAFETY: room for one.
        let result = unsafe { sys::gdp_alloc(self.raw(), (&raw mut raw).cast(), 1) };
        NonNull::new(raw).filter(|_| result == 0).map(Mbuf)
    }

    /// A packet that is what `of` is, without a copy of its bytes. `of` must be of one segment;
    /// neither may be written to from now on.
    pub(crate) fn refer(&self, of: &Mbuf) -> Option<Mbuf> {
        // SAFETY: a live mbuf and a live pool.
        let raw = unsafe { sys::gdp_refer(self.raw(), of.0.as_ptr().cast()) };
        NonNull::new(raw.cast()).map(Mbuf)
    }

    /// Mbufs that somebody has. Those that threads keep at hand are not among them.
    pub fn in_use(&self) -> u32 {
        // SAFETY: a live pool.
        unsafe { sys::rte_mempool_in_use_count(self.raw()) }
    }

    /// Mbufs in all.
    pub fn size(&self) -> u32 {
        self.0.size
    }

    /// Bytes of the largest packet.
    pub fn largest(&self) -> usize {
        self.0.largest
    }

    pub(crate) fn raw(&self) -> *mut sys::rte_mempool {
        self.0.pool.as_ptr()
    }
}

impl Drop for PoolInner {
    fn drop(&mut self) {
        // SAFETY: a live pool.
        let out = unsafe { sys::rte_mempool_in_use_count(self.pool.as_ptr()) };
        if out > 0 {
            // Somebody still has them, and their memory.
            return tracing::warn!(packets = out, "the memory of packets that are still in use is not given back");
        }
        // SAFETY: this was the last that had the pool, and none of its mbufs is out.
        unsafe { sys::rte_mempool_free(self.pool.as_ptr()) };
    }
}

/// A packet, in one segment unless it was [`Self::chain`]ed.
#[repr(transparent)]
pub struct Mbuf(pub(crate) NonNull<Raw>);

// SAFETY: one owner, wherever it is.
unsafe impl Send for Mbuf {}

impl Mbuf {
    /// The bytes of its first segment.
    #[inline]
    pub fn bytes(&self) -> &[u8] {
        let raw = self.raw();
        // SAFETY: so many bytes of the buffer are the packet's, from there on.
        unsafe { std::slice::from_raw_parts(raw.buffer.add(raw.data_offset.into()), raw.data_length.into()) }
    }

    /// Brings what headers lie in into the caches, without waiting for it.
    #[inline]
    pub fn fetch(&self) {
        let raw = self.raw();
        let begin = raw.buffer.wrapping_add(raw.data_offset.into());
        fetch(begin);
        fetch(begin.wrapping_add(64));
    }

    /// As [`Self::bytes`]; `None` if they are others' as well.
    #[inline]
    pub fn bytes_mut(&mut self) -> Option<&mut [u8]> {
        let raw = self.raw();
        if raw.references.load(Ordering::Relaxed) != 1 || raw.offload_flags & sys::GDP_ELSEWHERE != 0 {
            return None;
        }
        // SAFETY: as above, and nobody else has them.
        Some(unsafe { std::slice::from_raw_parts_mut(raw.buffer.add(raw.data_offset.into()), raw.data_length.into()) })
    }

    /// A copy of all bytes, of all segments.
    pub fn to_vec(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(self.len());
        let mut next = Some(self.0);
        while let Some(raw) = next {
            // SAFETY: a live segment of this packet, and so many bytes of its buffer are the
            // packet's.
            unsafe {
                let raw = raw.as_ref();
                let start = raw.buffer.add(raw.data_offset.into());
                bytes.extend_from_slice(std::slice::from_raw_parts(start, raw.data_length.into()));
                next = NonNull::new(sys::gdp_next(std::ptr::from_ref(raw).cast_mut().cast()).cast());
            }
        }
        bytes
    }

    /// Whether it is in one piece.
    pub fn is_linear(&self) -> bool {
        self.raw().segments == 1
    }

    /// Bytes of all segments.
    pub fn len(&self) -> usize {
        self.raw().packet_length as usize
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Has the first segment begin `front` bytes earlier, or later if that is negative, and be
    /// `length` bytes long. For mbufs in one piece; `false`, and nothing is changed, if there is no
    /// room.
    #[inline]
    pub fn reshape(&mut self, front: isize, length: usize) -> bool {
        let raw = self.raw_mut();
        let Some(offset) = (raw.data_offset as isize).checked_sub(front) else { return false };
        if raw.segments != 1 || offset < 0 || offset as usize + length > raw.buffer_length.into() {
            return false;
        }
        raw.data_offset = offset as u16;
        raw.data_length = length as u16;
        raw.packet_length = length as u32;
        // What a driver found out about the packet before is not true of it now.
        raw.offload_flags &= sys::GDP_ELSEWHERE;
        true
    }

    /// Puts another behind it. If that would be too many segments, the other is given back and it
    /// says `false`.
    pub(crate) fn chain(&mut self, tail: Mbuf) -> bool {
        // SAFETY: two live mbufs, of which this one owns the other from now on.
        let result = unsafe { sys::gdp_chain(self.0.as_ptr().cast(), tail.0.as_ptr().cast()) };
        if result == 0 {
            std::mem::forget(tail);
        }
        result == 0
    }

    #[inline]
    fn raw(&self) -> &Raw {
        // SAFETY: a live mbuf, whose fields only its owner changes.
        unsafe { self.0.as_ref() }
    }

    #[inline]
    fn raw_mut(&mut self) -> &mut Raw {
        // SAFETY: as above.
        unsafe { self.0.as_mut() }
    }
}

impl Drop for Mbuf {
    #[inline]
    fn drop(&mut self) {
        let mut raw = self.0.as_ptr();
        // SAFETY: one mbuf, with all that is chained to it, whose owner gives it back.
        unsafe { sys::gdp_free((&raw mut raw).cast(), 1) };
    }
}

/// Packets that arrive or leave together.
pub struct Burst {
    mbufs: [*mut Raw; Self::SIZE],
    length: usize,
}

// SAFETY: as `Mbuf`s.
unsafe impl Send for Burst {}

impl Burst {
    /// The most there are.
    pub const SIZE: usize = 64;

    pub fn new() -> Self {
        Self { mbufs: [std::ptr::null_mut(); Self::SIZE], length: 0 }
    }

    #[inline]
    pub fn is_full(&self) -> bool {
        self.length == Self::SIZE
    }

    /// Gives the mbuf back if there is no room for it.
    #[inline]
    pub fn push(&mut self, mbuf: Mbuf) -> Result<(), Mbuf> {
        if self.is_full() {
            return Err(mbuf);
        }
        self.mbufs[self.length] = ManuallyDrop::new(mbuf).0.as_ptr();
        self.length += 1;
        Ok(())
    }

    /// All of them, which then belong to the caller.
    #[inline]
    pub fn drain(&mut self) -> impl ExactSizeIterator<Item = Mbuf> {
        let length = std::mem::take(&mut self.length);
        Drain { mbufs: &self.mbufs[..length] }
    }

    /// Gives all back.
    pub fn clear(&mut self) {
        self.release(0);
    }

    /// Takes what `receive` puts into the room there is, of which it tells the number.
    pub(crate) fn fill(&mut self, receive: impl FnOnce(*mut *mut Raw, u16) -> u16) -> usize {
        let room = Self::SIZE - self.length;
        let received = usize::from(receive(self.mbufs[self.length..].as_mut_ptr(), room as u16)).min(room);
        self.length += received;
        received
    }

    /// Hands all to `send`, which tells how many of the first it has taken; the others are given
    /// back, and it tells how many these are.
    pub(crate) fn empty(&mut self, send: impl FnOnce(*mut *mut Raw, u16) -> u16) -> usize {
        let sent = usize::from(send(self.mbufs.as_mut_ptr(), self.length as u16)).min(self.length);
        let lost = self.length - sent;
        self.release(sent);
        lost
    }

    fn release(&mut self, from: usize) {
        let rest = &mut self.mbufs[from..self.length];
        if !rest.is_empty() {
            // SAFETY: live mbufs that nobody else has.
            unsafe { sys::gdp_free(rest.as_mut_ptr().cast(), rest.len() as u32) };
        }
        self.length = 0;
    }
}

impl Default for Burst {
    fn default() -> Self {
        Self::new()
    }
}

impl Deref for Burst {
    type Target = [Mbuf];

    fn deref(&self) -> &[Mbuf] {
        // SAFETY: so many live mbufs; `Mbuf` is transparent over a pointer that is not null.
        unsafe { std::slice::from_raw_parts(self.mbufs.as_ptr().cast(), self.length) }
    }
}

impl DerefMut for Burst {
    fn deref_mut(&mut self) -> &mut [Mbuf] {
        // SAFETY: as above, and nobody else has them.
        unsafe { std::slice::from_raw_parts_mut(self.mbufs.as_mut_ptr().cast(), self.length) }
    }
}

impl Drop for Burst {
    fn drop(&mut self) {
        self.clear();
    }
}

struct Drain<'a> {
    mbufs: &'a [*mut Raw],
}

impl Iterator for Drain<'_> {
    type Item = Mbuf;

    #[inline]
    fn next(&mut self) -> Option<Mbuf> {
        let (first, rest) = self.mbufs.split_first()?;
        self.mbufs = rest;
        NonNull::new(*first).map(Mbuf)
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        (self.mbufs.len(), Some(self.mbufs.len()))
    }
}

impl ExactSizeIterator for Drain<'_> {}

impl Drop for Drain<'_> {
    fn drop(&mut self) {
        self.for_each(drop);
    }
}
