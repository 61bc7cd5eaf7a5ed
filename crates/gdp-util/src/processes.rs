//! Child processes of this one.

use std::io;
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::Command;

/// Returns a command that runs a program of this project. The program gets SIGTERM when the calling
/// thread ends, so it does not outlive a process that is killed.
#[expect(clippy::disallowed_methods, reason = "the program is this project's own, so nobody installs it")]
pub fn command(program: &Path) -> Command {
    let mut command = Command::new(program);
    let end_with_parent = || {
        // SAFETY: the call only sets a property of the new process, and is async-signal-safe.
        match unsafe { libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGTERM) } {
            0 => Ok(()),
            _ => Err(io::Error::last_os_error()),
        }
    };
    // SAFETY: the closure makes one async-signal-safe call, and allocates nothing.
    unsafe { command.pre_exec(end_with_parent) };
    command
}

/// Sends SIGTERM to a child that this process has not yet waited for. Until then its number is not
/// used again.
pub fn terminate(child: u32) {
    if let Ok(child) = libc::pid_t::try_from(child) {
        // SAFETY: the call has no preconditions, and its only effect is the signal.
        unsafe { libc::kill(child, libc::SIGTERM) };
    }
}
