//! The limit on open file descriptors of this process.

use std::io;

/// Raises the soft limit on open file descriptors to the hard limit. Returns the new limit.
///
/// The usual soft limit of 1024 is for programs that use `select`. These programs use `epoll`, and
/// need several descriptors for each link and each DDS endpoint.
///
/// # Errors
///
/// Fails if the kernel refuses, for example because of a seccomp filter.
pub fn raise_limit() -> io::Result<u64> {
    let mut limit = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    // SAFETY: the call writes to this structure only.
    if unsafe { libc::getrlimit(libc::RLIMIT_NOFILE, &mut limit) } != 0 {
        return Err(io::Error::last_os_error());
    }
    limit.rlim_cur = limit.rlim_max;
    // SAFETY: the call reads this structure only.
    match unsafe { libc::setrlimit(libc::RLIMIT_NOFILE, &limit) } {
        0 => Ok(limit.rlim_cur),
        _ => Err(io::Error::last_os_error()),
    }
}
