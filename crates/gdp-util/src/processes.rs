//! Child processes of this one.

use std::path::Path;
use std::process::Command;

/// Returns a command that runs a program of this project.
#[expect(clippy::disallowed_methods, reason = "the program is this project's own, so nobody installs it")]
pub fn command(program: &Path) -> Command {
    Command::new(program)
}

/// Sends SIGTERM to a child that this process has not yet waited for. Until then its number is not
/// used again.
pub fn terminate(child: u32) {
    if let Ok(child) = libc::pid_t::try_from(child) {
        // SAFETY: the call has no preconditions, and its only effect is the signal.
        unsafe { libc::kill(child, libc::SIGTERM) };
    }
}
