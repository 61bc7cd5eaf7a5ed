//! Loads programs through the kernel's verifier. [`super::kernel`] and [`super::losses`] call it.

use std::io::ErrorKind;

use aya::programs::ProgramError;

/// Number of attempts, as in libbpf.
const ATTEMPTS: usize = 5;

/// Loads a program. The verifier fails with EAGAIN when a signal interrupts it; the load is then
/// repeated.
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
