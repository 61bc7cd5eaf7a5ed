//! Gives programs to the kernel's verifier. Called where programs are loaded: by [`super::kernel`]
//! and [`super::losses`].

use std::io::ErrorKind;

use aya::programs::ProgramError;

/// As many as libbpf makes.
const ATTEMPTS: usize = 5;

/// Has a program verified. The verifier gives up with EAGAIN when a signal comes meanwhile; then it
/// is asked again.
pub fn load(mut attempt: impl FnMut() -> Result<(), ProgramError>) -> Result<(), ProgramError> {
    let is_done = |result: &Result<(), ProgramError>| match result {
        Err(ProgramError::LoadError { io_error, .. }) => io_error.kind() != ErrorKind::WouldBlock,
        _ => true,
    };
    let early = (1..ATTEMPTS).map(|_| attempt()).find(is_done);
    early.unwrap_or_else(attempt)
}

#[cfg(test)]
#[path = "../tests/unit/verified.rs"]
mod tests;
