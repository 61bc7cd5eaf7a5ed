//! Descriptions of the kernel's errors, with the remedy. Error numbers alone would require reading
//! the source.

use aya::EbpfError;
use aya::maps::MapError;
use aya::programs::ProgramError;

use crate::kernel_failures::AttachError;

/// Describes why the object could not be loaded.
pub fn load(error: &EbpfError) -> String {
    match errno_of(error) {
        Some(libc::EPERM | libc::EACCES) => privileges(),
        Some(libc::ENOMEM) => "not enough memory for the FIB: set `fib_capacity` lower".into(),
        _ => chain(error),
    }
}

/// Describes why the kernel did not load the program.
pub fn program(error: &ProgramError) -> String {
    match error {
        ProgramError::LoadError { io_error, verifier_log } => match io_error.raw_os_error() {
            Some(libc::EPERM) => privileges(),
            // The verifier allows arithmetic on packet pointers only with CAP_PERFMON.
            Some(libc::EACCES) if verifier_log.to_string().contains("prohibited") => privileges(),
            _ => format!(
                "the kernel's verifier refused the program ({io_error}): {}",
                last_lines(&verifier_log.to_string(), 5)
            ),
        },
        other => chain(other),
    }
}

/// Describes why the program could not be attached to an interface.
pub fn attach(error: &AttachError) -> String {
    match errno_of(error) {
        Some(libc::EBUSY | libc::EEXIST) => "another XDP program is attached (`ip link show` names it)".into(),
        Some(libc::EOPNOTSUPP) => "the driver has none".into(),
        Some(libc::ERANGE | libc::EINVAL) => {
            "the driver refuses XDP with the interface's present MTU or offloads (on a veth: `ethtool -K DEV gro off \
             lro off`, or an MTU up to 3506)"
                .into()
        }
        Some(libc::ENOSPC | libc::ENOMEM) => "the driver has no queues left for XDP (`ethtool -L DEV combined N` \
                                              with a smaller N)"
            .into(),
        Some(libc::EPERM | libc::EACCES) => privileges(),
        Some(libc::ENODEV) => "the interface is gone".into(),
        _ => chain(error),
    }
}

/// Returns whether attaching failed because another program is attached. Generic mode does not help
/// then.
pub fn is_occupied(error: &AttachError) -> bool {
    matches!(errno_of(error), Some(libc::EBUSY | libc::EEXIST))
}

fn privileges() -> String {
    "not permitted: run as root, or with the capabilities CAP_BPF, CAP_PERFMON, CAP_NET_ADMIN and CAP_NET_RAW".into()
}

/// Returns the first operating system error number in the chain of causes.
fn errno_of(error: &(dyn std::error::Error + 'static)) -> Option<i32> {
    let mut next = Some(error);
    while let Some(error) = next {
        if let Some(io) = error.downcast_ref::<std::io::Error>() {
            return io.raw_os_error();
        }
        if let Some(MapError::SyscallError(call)) = error.downcast_ref() {
            return call.io_error.raw_os_error();
        }
        if let Some(ProgramError::SyscallError(call)) = error.downcast_ref() {
            return call.io_error.raw_os_error();
        }
        if let Some(AttachError::Program(program)) = error.downcast_ref() {
            return errno_of(program);
        }
        if let Some(EbpfError::MapError(map)) = error.downcast_ref() {
            return errno_of(map);
        }
        if let Some(EbpfError::ProgramError(program)) = error.downcast_ref() {
            return errno_of(program);
        }
        next = error.source();
    }
    None
}

fn chain(error: &(dyn std::error::Error + 'static)) -> String {
    let mut text = error.to_string();
    let mut next = error.source();
    while let Some(cause) = next {
        let cause_text = cause.to_string();
        if !text.contains(&cause_text) {
            text = format!("{text}: {cause_text}");
        }
        next = cause.source();
    }
    text
}

fn last_lines(text: &str, count: usize) -> String {
    let lines: Vec<&str> = text.lines().filter(|line| !line.trim().is_empty()).collect();
    lines[lines.len().saturating_sub(count)..].join(" | ")
}
