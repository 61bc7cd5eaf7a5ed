//! Packets in DPDK's memory, and their pools. An [`Mbuf`] owns its packet and frees it on drop, so
//! that no error path leaks memory.

use std::ffi::CString;
use std::mem::ManuallyDrop;
use std::ops::{Deref, DerefMut};
use std::ptr::NonNull;
use std::sync::Arc;
use std::sync::atomic::{AtomicU16, AtomicU32, Ordering};

use gdp_wire::fetch::fetch;

use crate::{DpdkError, Eal, sys};

/// Size in bytes of the largest packet in an mbuf: a jumbo frame.
pub const LARGEST: usize = 9216;

/// Headroom in bytes in front of a received packet. Outgoing headers need less.
const HEADROOM: u16 = sys::RTE_PKTMBUF_HEADROOM as u16;

/// Number of mbufs in each thread's cache, unless the pool is small. A cache may briefly have half
/// as many more.
const CACHE: u32 = 256;
pub(crate) const CACHED: usize = CACHE as usize * 3 / 2;

/// The first fields of DPDK's `rte_mbuf`. The shim asserts their offsets.
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

/// A pool of mbufs. Clones share the pool, which exists until its last mbuf is freed.
#[derive(Clone)]
pub struct Pool(Arc<PoolInner>);

struct PoolInner {
    pool: NonNull<sys::rte_mempool>,
    size: u32,
    largest: usize,
    _eal: Eal,
}

// SAFETY: DPDK's pools are thread-safe.
unsafe impl Send for PoolInner {}
// SAFETY: as above.
unsafe impl Sync for PoolInner {}

impl Pool {
    /// Creates a pool of `size` mbufs, each with room for a packet of `largest` bytes.
    pub fn new(eal: Eal, size: u32, largest: usize) -> Result<Self, DpdkError> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let what = || format!("a pool of {size} packets of {largest} bytes");
        let largest = largest.min(LARGEST);
        let name = format!("gdp-{}", NUMBER.fetch_add(1, Ordering::Relaxed));
        let name = CString::new(name).map_err(|_| DpdkError::new(what(), libc::EINVAL))?;
        let room = HEADROOM + largest as u16;
        let cache = CACHE.min(size / 4);
        // SAFETY: the name outlives the call.
        let pool = unsafe { sys::gdp_pool_create(name.as_ptr(), size, cache, room) };
        let pool = NonNull::new(pool).ok_or_else(|| {
            DpdkError::last(what()).with_remedy("; give DPDK more memory (`dpdk.memory_mib`, or huge pages)")
        })?;
        Ok(Self(Arc::new(PoolInner { pool, size, largest, _eal: eal })))
    }

    /// Allocates an empty packet.
    pub fn alloc(&self) -> Option<Mbuf> {
        let mut raw: *mut Raw = std::ptr::null_mut();
        // SAFETY: the array has room for one pointer.
        let result = unsafe { sys::gdp_alloc(self.raw(), (&raw mut raw).cast(), 1) };
        NonNull::new(raw).filter(|_| result == 0).map(Mbuf)
    }

    /// Returns a packet that shares the bytes of `of` without copying. `of` must have one segment.
    /// Neither packet may be written afterwards.
    pub(crate) fn refer(&self, of: &Mbuf) -> Option<Mbuf> {
        // SAFETY: the mbuf and the pool are live.
        let raw = unsafe { sys::gdp_refer(self.raw(), of.0.as_ptr().cast()) };
        NonNull::new(raw.cast()).map(Mbuf)
    }

    /// Returns the number of allocated mbufs. Mbufs in thread caches are not included.
    pub fn in_use(&self) -> u32 {
        // SAFETY: the pool is live.
        unsafe { sys::rte_mempool_in_use_count(self.raw()) }
    }

    /// Returns the total number of mbufs.
    pub fn size(&self) -> u32 {
        self.0.size
    }

    /// Returns the size in bytes of the largest packet.
    pub fn largest(&self) -> usize {
        self.0.largest
    }

    pub(crate) fn raw(&self) -> *mut sys::rte_mempool {
        self.0.pool.as_ptr()
    }
}

impl Drop for PoolInner {
    fn drop(&mut self) {
        // SAFETY: the pool is live.
        let out = unsafe { sys::rte_mempool_in_use_count(self.pool.as_ptr()) };
        if out > 0 {
            // These mbufs are still in use, so their memory must remain.
            return tracing::warn!(packets = out, "the memory of packets that are still in use is not given back");
        }
        // SAFETY: this was the last reference to the pool, and all its mbufs are free.
        unsafe { sys::rte_mempool_free(self.pool.as_ptr()) };
    }
}

/// A packet, in one segment unless [`Self::chain`] added more.
#[repr(transparent)]
pub struct Mbuf(pub(crate) NonNull<Raw>);

// SAFETY: an mbuf has a single owner, on any thread.
unsafe impl Send for Mbuf {}

impl Mbuf {
    /// Returns the bytes of the first segment.
    #[inline]
    pub fn bytes(&self) -> &[u8] {
        let raw = self.raw();
        // SAFETY: this range of the buffer belongs to the packet.
        unsafe { std::slice::from_raw_parts(raw.buffer.add(raw.data_offset.into()), raw.data_length.into()) }
    }

    /// Prefetches the cache lines of the headers.
    #[inline]
    pub fn fetch(&self) {
        let raw = self.raw();
        let begin = raw.buffer.wrapping_add(raw.data_offset.into());
        fetch(begin);
        fetch(begin.wrapping_add(64));
    }

    /// Returns the bytes as [`Self::bytes`] does; `None` if they are shared.
    #[inline]
    pub fn bytes_mut(&mut self) -> Option<&mut [u8]> {
        let raw = self.raw();
        if raw.references.load(Ordering::Relaxed) != 1 || raw.offload_flags & sys::GDP_ELSEWHERE != 0 {
            return None;
        }
        // SAFETY: as above, and the bytes are not shared.
        Some(unsafe { std::slice::from_raw_parts_mut(raw.buffer.add(raw.data_offset.into()), raw.data_length.into()) })
    }

    /// Copies the bytes of all segments.
    pub fn to_vec(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(self.len());
        let mut next = Some(self.0);
        while let Some(raw) = next {
            // SAFETY: the segment of this packet is live, and this range of its buffer belongs to
            // the packet.
            unsafe {
                let raw = raw.as_ref();
                let start = raw.buffer.add(raw.data_offset.into());
                bytes.extend_from_slice(std::slice::from_raw_parts(start, raw.data_length.into()));
                next = NonNull::new(sys::gdp_next(std::ptr::from_ref(raw).cast_mut().cast()).cast());
            }
        }
        bytes
    }

    /// Returns whether the packet has only one segment.
    pub fn is_linear(&self) -> bool {
        self.raw().segments == 1
    }

    /// Returns the length in bytes of all segments.
    pub fn len(&self) -> usize {
        self.raw().packet_length as usize
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Moves the start of the packet `front` bytes towards the headroom, or away from it if
    /// negative, and sets its length. The packet must have one segment. Returns `false` without
    /// changes if there is not enough room.
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
        // The driver's offload results no longer apply to the changed packet.
        raw.offload_flags &= sys::GDP_ELSEWHERE;
        true
    }

    /// Appends the segments of `tail`. If the chain would be too long, frees `tail` and returns
    /// `false`.
    pub(crate) fn chain(&mut self, tail: Mbuf) -> bool {
        // SAFETY: both mbufs are live, and this mbuf owns the other from now on.
        let result = unsafe { sys::gdp_chain(self.0.as_ptr().cast(), tail.0.as_ptr().cast()) };
        if result == 0 {
            std::mem::forget(tail);
        }
        result == 0
    }

    #[inline]
    fn raw(&self) -> &Raw {
        // SAFETY: the mbuf is live, and only its owner changes its fields.
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
        // SAFETY: the owner frees one mbuf and all mbufs chained to it.
        unsafe { sys::gdp_free((&raw mut raw).cast(), 1) };
    }
}

/// Packets that arrive or leave together.
pub struct Burst {
    mbufs: [*mut Raw; Self::SIZE],
    length: usize,
}

// SAFETY: as for `Mbuf`.
unsafe impl Send for Burst {}

impl Burst {
    /// Maximum number of packets.
    pub const SIZE: usize = 64;

    pub fn new() -> Self {
        Self { mbufs: [std::ptr::null_mut(); Self::SIZE], length: 0 }
    }

    #[inline]
    pub fn is_full(&self) -> bool {
        self.length == Self::SIZE
    }

    /// Appends an mbuf. Returns the mbuf as the error if the burst is full.
    #[inline]
    pub fn push(&mut self, mbuf: Mbuf) -> Result<(), Mbuf> {
        if self.is_full() {
            return Err(mbuf);
        }
        self.mbufs[self.length] = ManuallyDrop::new(mbuf).0.as_ptr();
        self.length += 1;
        Ok(())
    }

    /// Removes and returns all packets.
    #[inline]
    pub fn drain(&mut self) -> impl ExactSizeIterator<Item = Mbuf> {
        let length = std::mem::take(&mut self.length);
        Drain { mbufs: &self.mbufs[..length] }
    }

    /// Frees all packets.
    pub fn clear(&mut self) {
        self.release(0);
    }

    /// Appends the packets that `receive` writes to the free slots. `receive` returns their number.
    pub(crate) fn fill(&mut self, receive: impl FnOnce(*mut *mut Raw, u16) -> u16) -> usize {
        let room = Self::SIZE - self.length;
        let received = usize::from(receive(self.mbufs[self.length..].as_mut_ptr(), room as u16)).min(room);
        self.length += received;
        received
    }

    /// Passes all packets to `send`, which returns the number of leading packets it accepted. Frees
    /// the others and returns their number.
    pub(crate) fn empty(&mut self, send: impl FnOnce(*mut *mut Raw, u16) -> u16) -> usize {
        let sent = usize::from(send(self.mbufs.as_mut_ptr(), self.length as u16)).min(self.length);
        let lost = self.length - sent;
        self.release(sent);
        lost
    }

    fn release(&mut self, from: usize) {
        let rest = &mut self.mbufs[from..self.length];
        if !rest.is_empty() {
            // SAFETY: the mbufs are live, and no other code owns them.
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
        // SAFETY: the array has this number of live mbufs; `Mbuf` is transparent over a non-null
        // pointer.
        unsafe { std::slice::from_raw_parts(self.mbufs.as_ptr().cast(), self.length) }
    }
}

impl DerefMut for Burst {
    fn deref_mut(&mut self) -> &mut [Mbuf] {
        // SAFETY: as above, and the borrow is exclusive.
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
