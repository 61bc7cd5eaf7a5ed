//! Words with only atomic access. They are either the memory of a BPF array, which programs and
//! other processes may change at any time, or private memory. [`super::link_memory`],
//! [`super::fib`] and [`super::tables`] use them.

use std::io;
use std::os::fd::{AsFd, AsRawFd, RawFd};
use std::ptr::NonNull;
use std::sync::atomic::AtomicU64;

use aya::maps::MapData;

/// A mapping of whole pages. The mapping of an array outlives the array's descriptor.
pub struct Mapping {
    start: NonNull<AtomicU64>,
    words: usize,
}

impl Mapping {
    /// Maps the first words of an array created with `BPF_F_MMAPABLE`. The array must have at least
    /// this many words.
    pub fn new(map: &MapData, words: usize) -> io::Result<Self> {
        Self::map(map.fd().as_fd().as_raw_fd(), libc::MAP_SHARED | libc::MAP_POPULATE, words)
    }

    /// Maps zeroed private memory; its pages use no memory until they are written. It uses huge
    /// pages where available. Without them, each lookup in a table of a million names would need a
    /// page-table walk.
    pub fn own(words: usize) -> io::Result<Self> {
        let mapping = Self::map(-1, libc::MAP_PRIVATE | libc::MAP_ANONYMOUS, words)?;
        // SAFETY: this advice affects only this mapping and does not change its contents. A kernel
        // without huge pages refuses it.
        unsafe { libc::madvise(mapping.start.as_ptr().cast(), words * size_of::<AtomicU64>(), libc::MADV_HUGEPAGE) };
        Ok(mapping)
    }

    fn map(fd: RawFd, flags: i32, words: usize) -> io::Result<Self> {
        let (bytes, access) = (words * size_of::<AtomicU64>(), libc::PROT_READ | libc::PROT_WRITE);
        // SAFETY: the call makes a new mapping, of an open descriptor or anonymous, and replaces no
        // existing mapping. The kernel refuses mappings larger than the array.
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
        // SAFETY: `map` mapped this many words here, aligned to a page. They remain mapped until
        // `drop`.
        unsafe { std::slice::from_raw_parts(self.start.as_ptr(), self.words) }
    }
}

// SAFETY: the mapping belongs to this value, and all access to it is atomic.
unsafe impl Send for Mapping {}
// SAFETY: as above.
unsafe impl Sync for Mapping {}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: `map` made this mapping, and it is unmapped once.
        unsafe { libc::munmap(self.start.as_ptr().cast(), self.words * size_of::<AtomicU64>()) };
    }
}
