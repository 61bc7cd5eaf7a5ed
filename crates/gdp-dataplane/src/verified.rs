//! Gives programs to the kernel's verifier. Called where programs are loaded: by [`super::kernel`] and [`super::losses`].

use std::io::ErrorKind;

use aya::programs::ProgramError;

/// As many as libbpf makes.
const ATTEMPTS: usize = 5;

/// Has a program verified. The verifier gives up with EAGAIN when a signal comes meanwhile; then it is asked again.
pub fn load(mut attempt: impl FnMut() -> Result<(), ProgramError>) -> Result<(), ProgramError> {
    let is_done = |result: &Result<(), ProgramError>| match result {
        Err(ProgramError::LoadError { io_error, .. }) => io_error.kind() != ErrorKind::WouldBlock,
        _ => true,
    };
    let early = (1..ATTEMPTS).map(|_| attempt()).find(is_done);
    early.unwrap_or_else(attempt)
}

#[cfg(test)]
mod tests {
    use aya_obj::VerifierLog;

    use super::*;

    #[test]
    fn only_what_was_interrupted_is_tried_again_and_not_for_ever() {
        for (interruptions, errno, expected) in [
            (0, libc::EAGAIN, (1, true)),
            (3, libc::EAGAIN, (4, true)),
            (4, libc::EAGAIN, (5, true)),
            (9, libc::EAGAIN, (5, false)),
            (1, libc::EACCES, (1, false)),
        ] {
            let mut attempts = 0;
            let result = load(|| {
                attempts += 1;
                if attempts > interruptions {
                    return Ok(());
                }
                let io_error = std::io::Error::from_raw_os_error(errno);
                Err(ProgramError::LoadError { io_error, verifier_log: VerifierLog::new(String::new()) })
            });
            assert_eq!((attempts, result.is_ok()), expected, "{interruptions} times {errno}");
        }
    }
}
