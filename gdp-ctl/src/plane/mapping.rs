//! The memory of a BPF array in this process. Programs and other processes may change it at any moment, so it is words that are
//! only ever accessed atomically. For [`super::link_memory`] and [`super::fib`].

use std::io;
use std::os::fd::{AsFd, AsRawFd};
use std::ptr::NonNull;
use std::sync::atomic::AtomicU64;

use aya::maps::MapData;

/// A mapping of the first words of an array made with `BPF_F_MMAPABLE`. It outlives the array's descriptor.
pub struct Mapping {
    start: NonNull<AtomicU64>,
    words: usize,
}

impl Mapping {
    /// `words`: no more than the array has.
    pub fn new(map: &MapData, words: usize) -> io::Result<Self> {
        let (fd, bytes) = (map.fd().as_fd().as_raw_fd(), words * size_of::<AtomicU64>());
        let (access, flags) = (libc::PROT_READ | libc::PROT_WRITE, libc::MAP_SHARED | libc::MAP_POPULATE);
        // SAFETY: a fresh mapping of a descriptor that is open; nothing existing is replaced. The kernel refuses what is
        // larger than the array.
        let address = unsafe { libc::mmap(std::ptr::null_mut(), bytes, access, flags, fd, 0) };
        match NonNull::new(address) {
            Some(start) if address != libc::MAP_FAILED => Ok(Self { start: start.cast(), words }),
            _ => Err(io::Error::last_os_error()),
        }
    }
}

impl AsRef<[AtomicU64]> for Mapping {
    fn as_ref(&self) -> &[AtomicU64] {
        // SAFETY: `new` mapped so many words here, aligned to a page; they stay until `drop`.
        unsafe { std::slice::from_raw_parts(self.start.as_ptr(), self.words) }
    }
}

// SAFETY: the mapping belongs to this value, and all access to it is atomic.
unsafe impl Send for Mapping {}
// SAFETY: as above.
unsafe impl Sync for Mapping {}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: the mapping that `new` made, unmapped once.
        unsafe { libc::munmap(self.start.as_ptr().cast(), self.words * size_of::<AtomicU64>()) };
    }
}
