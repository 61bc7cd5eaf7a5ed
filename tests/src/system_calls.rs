//! Counts the system calls of programs, by the kernel's tracepoint.

use std::fs;
use std::io;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};

use anyhow::{Context, Result};

use crate::process::Process;

/// The number of the tracepoint, where tracefs is mounted.
const TRACEPOINT: &str = "/sys/kernel/tracing/events/raw_syscalls/sys_enter/id";

/// The first version of the kernel's `struct perf_event_attr` (`linux/perf_event.h`).
#[repr(C)]
#[derive(Default)]
struct Attributes {
    kind: u32,
    size: u32,
    config: u64,
    sample_period: u64,
    sample_type: u64,
    read_format: u64,
    flags: u64,
    wakeup_events: u32,
    breakpoint_type: u32,
    breakpoint_address: u64,
}

const PERF_TYPE_TRACEPOINT: u32 = 2;
/// The flag `inherit`: threads that a thread starts count as well.
const INHERIT: u64 = 1 << 1;

const PERF_FLAG_FD_CLOEXEC: libc::c_ulong = 1 << 3;

/// The counters of some programs' threads.
pub struct SystemCalls(Vec<OwnedFd>);

impl SystemCalls {
    /// Begins to count. Returns `None` where the kernel has no tracepoint or tracefs is not
    /// mounted.
    pub fn of(programs: &[&Process]) -> Result<Option<Self>> {
        let Ok(number) = fs::read_to_string(TRACEPOINT) else { return Ok(None) };
        let attributes = Attributes {
            kind: PERF_TYPE_TRACEPOINT,
            size: size_of::<Attributes>() as u32,
            config: number.trim().parse().context("the number of the tracepoint")?,
            flags: INHERIT,
            ..Attributes::default()
        };
        let mut counters = Vec::new();
        for program in programs {
            let threads = fs::read_dir(format!("/proc/{}/task", program.pid())).context("its threads")?;
            for thread in threads.flatten() {
                let Some(thread) = thread.file_name().to_str().and_then(|name| name.parse().ok()) else { continue };
                match open(&attributes, thread) {
                    Ok(counter) => counters.push(counter),
                    // It has ended meanwhile.
                    Err(error) if error.raw_os_error() == Some(libc::ESRCH) => {}
                    Err(error) => return Err(error).context("cannot count system calls"),
                }
            }
        }
        Ok(Some(Self(counters)))
    }

    /// Returns their number since the beginning.
    pub fn read(&self) -> Result<u64> {
        let counts = self.0.iter().map(|counter| {
            let mut count = [0; 8];
            // SAFETY: the buffer has the length that is passed.
            match unsafe { libc::read(counter.as_raw_fd(), count.as_mut_ptr().cast(), count.len()) } {
                8 => Ok(u64::from_ne_bytes(count)),
                _ => Err(io::Error::last_os_error()),
            }
        });
        counts.sum::<io::Result<u64>>().context("cannot read a counter of system calls")
    }
}

fn open(attributes: &Attributes, thread: libc::pid_t) -> io::Result<OwnedFd> {
    const ANY_PROCESSOR: i32 = -1;
    const NO_GROUP: i32 = -1;
    // SAFETY: the attributes state their size, and the kernel only reads them.
    let counter = unsafe {
        libc::syscall(
            libc::SYS_perf_event_open,
            std::ptr::from_ref(attributes),
            thread,
            ANY_PROCESSOR,
            NO_GROUP,
            PERF_FLAG_FD_CLOEXEC,
        )
    };
    match i32::try_from(counter) {
        // SAFETY: the kernel has opened it for this call.
        Ok(counter @ 0..) => Ok(unsafe { OwnedFd::from_raw_fd(counter) }),
        _ => Err(io::Error::last_os_error()),
    }
}
