//! Assignment of CPUs. The code under measurement has its own CPU; the load that disturbs it, or
//! its peer, gets another.

use std::collections::BTreeSet;

use anyhow::{Context, Result, ensure};

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
    keep(cpu, 0)
}

/// Keeps all threads of a program on a CPU. Threads that it starts later inherit the CPU.
pub fn keep_program(cpu: usize, pid: u32) -> Result<()> {
    let threads = || -> Result<BTreeSet<libc::pid_t>> {
        let folder = std::fs::read_dir(format!("/proc/{pid}/task")).with_context(|| format!("no program {pid}"))?;
        Ok(folder.flatten().filter_map(|thread| thread.file_name().to_str()?.parse().ok()).collect())
    };
    let mut kept = BTreeSet::new();
    // A thread may start others before it is kept itself.
    loop {
        let new: Vec<libc::pid_t> = threads()?.difference(&kept).copied().collect();
        if new.is_empty() {
            return Ok(());
        }
        for thread in new {
            kept.insert(thread);
            // It may have ended meanwhile.
            if let Err(error) = keep(cpu, thread)
                && threads()?.contains(&thread)
            {
                return Err(error);
            }
        }
    }
}

/// Keeps a thread on a CPU; 0 is the calling one.
fn keep(cpu: usize, thread: libc::pid_t) -> Result<()> {
    // SAFETY: all zeros are an empty set.
    let mut set: libc::cpu_set_t = unsafe { std::mem::zeroed() };
    // SAFETY: the set is live, and the number is below the set's size in bits.
    unsafe { libc::CPU_SET(cpu, &mut set) };
    // SAFETY: pointer and size are those of the set.
    let result = unsafe { libc::sched_setaffinity(thread, size_of_val(&set), &set) };
    ensure!(result == 0, "cannot stay on CPU {cpu}: {}", std::io::Error::last_os_error());
    Ok(())
}
