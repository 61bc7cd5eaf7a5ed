//! Unit tests of `verified`.

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
