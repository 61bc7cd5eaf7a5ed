//! Which CPUs work. What is measured has one of its own; what is to disturb it, or its other end,
//! gets another.

use anyhow::{Result, ensure};

/// Of what sends, and with it of the XDP programs and the kernel's routers behind it.
pub const SENDER: usize = 0;

/// Of what is beside it.
pub const OTHER: usize = 1;

/// Runs something on a thread of its own, which stays on a CPU for as long as it lives.
pub fn on<T: Send>(cpu: usize, work: impl FnOnce() -> Result<T> + Send) -> Result<T> {
    match std::thread::scope(|scope| scope.spawn(|| pin(cpu).and_then(|()| work())).join()) {
        Ok(done) => done,
        Err(panic) => std::panic::resume_unwind(panic),
    }
}

/// Keeps the calling thread on a CPU.
pub fn pin(cpu: usize) -> Result<()> {
    // SAFETY: all zeros are an empty set.
    let mut set: libc::cpu_set_t = unsafe { std::mem::zeroed() };
    // SAFETY: the set is live, and the number less than the bits it has.
    unsafe { libc::CPU_SET(cpu, &mut set) };
    // SAFETY: pointer and size are of the set.
    let result = unsafe { libc::sched_setaffinity(0, size_of_val(&set), &set) };
    ensure!(result == 0, "cannot stay on CPU {cpu}: {}", std::io::Error::last_os_error());
    Ok(())
}
