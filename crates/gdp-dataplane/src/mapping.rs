//! Words that are only ever accessed atomically: the memory of a BPF array in this process, which
//! programs and other processes may change at any moment, or memory of this process alone. For
//! [`super::link_memory`], [`super::fib`] and [`super::tables`].

use std::io;
use std::os::fd::{AsFd, AsRawFd, RawFd};
use std::ptr::NonNull;
use std::sync::atomic::AtomicU64;

use aya::maps::MapData;

/// A mapping of whole pages. That of an array outlives the array's descriptor.
pub struct Mapping {
    start: NonNull<AtomicU64>,
    words: usize,
}

impl Mapping {
    /// The first words of an array made with `BPF_F_MMAPABLE`; no more than it has.
    pub fn new(map: &MapData, words: usize) -> io::Result<Self> {
        Self::map(map.fd().as_fd().as_raw_fd(), libc::MAP_SHARED | libc::MAP_POPULATE, words)
    }

    /// Words that are zero; pages of them use no memory before they are written to. Huge pages
    /// where the kernel has some: in a table of a million names each look-up would have to find its
    /// page otherwise.
    pub fn own(words: usize) -> io::Result<Self> {
        let mapping = Self::map(-1, libc::MAP_PRIVATE | libc::MAP_ANONYMOUS, words)?;
        // SAFETY: advice about this mapping, which changes nothing that is in it. A kernel without
        // huge pages refuses it.
        unsafe { libc::madvise(mapping.start.as_ptr().cast(), words * size_of::<AtomicU64>(), libc::MADV_HUGEPAGE) };
        Ok(mapping)
    }

    fn map(fd: RawFd, flags: i32, words: usize) -> io::Result<Self> {
        let (bytes, access) = (words * size_of::<AtomicU64>(), libc::PROT_READ | libc::PROT_WRITE);
        // SAFETY: a fresh mapping, of a descriptor that is open or of none; nothing existing is
        // replaced. The kernel refuses what is larger than the array.
        let address = unsafe { libc::mmap(std::ptr::null_mut(), bytes, access, flags, fd, 0) };
        match NonNull::new(address) {
            Some(start) if address != libc::MAP_FAILED => Ok(Self { start: start.cast(), words }),
            _ => Err(io::Error::last_os_error()),
        }
    }
}

impl AsRef<[AtomicU64]> for Mapping {
    #[inline]
    fn as_ref(&self) -> &[AtomicU64] {
        // SAFETY: `map` mapped so many words here, aligned to a page; they stay until `drop`.
        unsafe { std::slice::from_raw_parts(self.start.as_ptr(), self.words) }
    }
}

// SAFETY: the mapping belongs to this value, and all access to it is atomic.
unsafe impl Send for Mapping {}
// SAFETY: as above.
unsafe impl Sync for Mapping {}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: the mapping that `map` made, unmapped once.
        unsafe { libc::munmap(self.start.as_ptr().cast(), self.words * size_of::<AtomicU64>()) };
    }
}
