//! Assignment of CPUs. The code under measurement has its own CPU; the load that disturbs it, or
//! its peer, gets another.

use anyhow::{Result, ensure};

/// The CPU of the sender, and therefore of the XDP programs and kernel routers behind it.
pub const SENDER: usize = 0;

/// The CPU of everything else.
pub const OTHER: usize = 1;

/// Runs a closure on a new thread that stays on one CPU for its lifetime.
pub fn on<T: Send>(cpu: usize, work: impl FnOnce() -> Result<T> + Send) -> Result<T> {
    match std::thread::scope(|scope| scope.spawn(|| pin(cpu).and_then(|()| work())).join()) {
        Ok(done) => done,
        Err(panic) => std::panic::resume_unwind(panic),
    }
}

/// Pins the calling thread to a CPU.
pub fn pin(cpu: usize) -> Result<()> {
    // SAFETY: all zeros are an empty set.
    let mut set: libc::cpu_set_t = unsafe { std::mem::zeroed() };
    // SAFETY: the set is live, and the number is below the set's size in bits.
    unsafe { libc::CPU_SET(cpu, &mut set) };
    // SAFETY: pointer and size are those of the set.
    let result = unsafe { libc::sched_setaffinity(0, size_of_val(&set), &set) };
    ensure!(result == 0, "cannot stay on CPU {cpu}: {}", std::io::Error::last_os_error());
    Ok(())
}
