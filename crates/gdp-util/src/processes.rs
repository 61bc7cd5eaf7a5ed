//! Signals to the child processes of this one.

/// Sends SIGTERM to a child that this process has not yet waited for. Until then its number is not
/// used again.
pub fn terminate(child: u32) {
    if let Ok(child) = libc::pid_t::try_from(child) {
        // SAFETY: the call has no preconditions, and its only effect is the signal.
        unsafe { libc::kill(child, libc::SIGTERM) };
    }
}
