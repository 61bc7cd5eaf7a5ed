//! The limit of Unix: `RLIMIT_NOFILE`.

use std::io;
use std::os::fd::AsRawFd;

/// Number of descriptors that connections leave for links, files and discovery.
pub const RESERVE: u64 = 64;

/// Whether a new descriptor is one of the last [`RESERVE`] that the limit allows. Its owner then
/// closes it. The kernel assigns the lowest free number, so the number tells how many are open.
pub fn is_reserved(new: &impl AsRawFd) -> bool {
    let Ok(limit) = limit() else { return false };
    u64::try_from(new.as_raw_fd()).is_ok_and(|number| number >= limit.rlim_cur.saturating_sub(RESERVE))
}

/// Raises the soft limit on open file descriptors to the hard limit. Returns the new limit.
///
/// The usual soft limit of 1024 is for programs that use `select`. These programs use `epoll`, and
/// need several descriptors for each link and each DDS endpoint.
///
/// # Errors
///
/// Fails if the kernel refuses, for example because of a seccomp filter.
pub fn raise_limit() -> io::Result<u64> {
    let mut limit = limit()?;
    limit.rlim_cur = limit.rlim_max;
    // SAFETY: the call reads this structure only.
    match unsafe { libc::setrlimit(libc::RLIMIT_NOFILE, &limit) } {
        0 => Ok(limit.rlim_cur),
        _ => Err(io::Error::last_os_error()),
    }
}

fn limit() -> io::Result<libc::rlimit> {
    let mut limit = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    // SAFETY: the call writes to this structure only.
    match unsafe { libc::getrlimit(libc::RLIMIT_NOFILE, &mut limit) } {
        0 => Ok(limit),
        _ => Err(io::Error::last_os_error()),
    }
}
