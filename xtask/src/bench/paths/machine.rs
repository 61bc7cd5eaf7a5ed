//! The processor time of the whole machine, with the kernel's interrupts.

use std::time::{Duration, Instant};

use anyhow::{Context, Result};

/// A reading of the machine's clocks.
pub struct MachineTime {
    at: Instant,
    processors: u32,
    /// Time in which all processors together had nothing to do.
    idle: Duration,
    /// Processor time of this process, which only waits and carries the frames of bad links.
    own: Duration,
}

impl MachineTime {
    pub fn now() -> Result<Self> {
        let text = std::fs::read_to_string("/proc/stat").context("cannot read /proc/stat")?;
        let (idle, processors) = parse(&text).context("/proc/stat has no idle time")?;
        Ok(Self { at: Instant::now(), processors, idle, own: own()? })
    }

    /// Returns the processor time that all other programs and the kernel have taken since.
    pub fn taken(&self) -> Result<Duration> {
        let now = Self::now()?;
        let (idle, own) = (now.idle.saturating_sub(self.idle), now.own.saturating_sub(self.own));
        Ok((now.at - self.at).saturating_mul(self.processors).saturating_sub(idle + own))
    }
}

/// Returns the idle time in /proc/stat, with that spent waiting for disks, and the number of
/// processors. The kernel measures idle time exactly, and other kinds by its ticks.
fn parse(text: &str) -> Option<(Duration, u32)> {
    let processors = text.lines().filter(|line| line.starts_with("cpu") && !line.starts_with("cpu ")).count();
    let total: Vec<&str> = text.lines().find(|line| line.starts_with("cpu "))?.split_ascii_whitespace().collect();
    let (idle, disks) = (total.get(4)?.parse::<u64>().ok()?, total.get(5)?.parse::<u64>().ok()?);
    // SAFETY: sysconf has no preconditions.
    let ticks = unsafe { libc::sysconf(libc::_SC_CLK_TCK) }.max(1) as f64;
    Some((Duration::from_secs_f64((idle + disks) as f64 / ticks), processors as u32))
}

fn own() -> Result<Duration> {
    // SAFETY: all zeros are a valid rusage.
    let mut usage: libc::rusage = unsafe { std::mem::zeroed() };
    // SAFETY: a pointer to a live rusage.
    let result = unsafe { libc::getrusage(libc::RUSAGE_SELF, &mut usage) };
    anyhow::ensure!(result == 0, "getrusage: {}", std::io::Error::last_os_error());
    let time = |value: libc::timeval| Duration::new(value.tv_sec as u64, value.tv_usec as u32 * 1000);
    Ok(time(usage.ru_utime) + time(usage.ru_stime))
}

#[cfg(test)]
#[path = "../../../tests/unit/machine.rs"]
mod tests;
