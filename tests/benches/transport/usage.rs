//! Memory of this process, and CPU time. CPU time covers the process's threads in a site's
//! namespaces, and the kernel's threads that finish the work of interrupts. The kernel charges an
//! interrupt's own time to the thread it interrupts. On an otherwise idle machine, that is a
//! measured thread.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result};
use gdp_tests::chain::Chain;

/// The threads whose time is measured.
pub struct Meter {
    /// Inodes of the namespaces.
    namespaces: Vec<u64>,
    /// Folders of kernel threads in `/proc`.
    kernel: Vec<PathBuf>,
}

impl Meter {
    pub fn new(chain: &Chain) -> Result<Self> {
        let inode = |name: &str| Ok(fs::metadata(Path::new("/run/netns").join(name))?.ino());
        let namespaces = chain.nodes().iter().map(|node| inode(node.name())).collect::<Result<_>>()?;
        let is_softirq = |folder: &PathBuf| {
            fs::read_to_string(folder.join("comm")).is_ok_and(|command| command.starts_with("ksoftirqd/"))
        };
        let processes = fs::read_dir("/proc")?.filter_map(|entry| Some(entry.ok()?.path()));
        Ok(Self { namespaces, kernel: processes.filter(is_softirq).collect() })
    }

    /// Returns the CPU time since the threads began. A thread that has ended no longer counts, so
    /// no thread should end between two calls.
    pub fn total(&self) -> Result<Duration> {
        let mut total = Duration::ZERO;
        for entry in fs::read_dir("/proc/self/task")? {
            let thread = entry?.path();
            // A thread may have ended meanwhile.
            if fs::metadata(thread.join("ns/net")).is_ok_and(|net| self.namespaces.contains(&net.ino())) {
                total += time(&thread)?;
            }
        }
        self.kernel.iter().try_fold(total, |total, thread| Ok(total + time(thread)?))
    }
}

/// Returns the resident bytes of this process.
pub fn resident() -> Result<f64> {
    let status = fs::read_to_string("/proc/self/status")?;
    let kilobytes = status.lines().find_map(|line| line.strip_prefix("VmRSS:")?.trim().strip_suffix(" kB"));
    Ok(1024.0 * kilobytes.context("no VmRSS in /proc/self/status")?.parse::<f64>()?)
}

fn time(thread: &Path) -> Result<Duration> {
    let text = fs::read_to_string(thread.join("schedstat")).context("a kernel with CONFIG_SCHED_INFO")?;
    let nanoseconds = text.split(' ').next().context("an empty schedstat")?.parse()?;
    Ok(Duration::from_nanos(nanoseconds))
}
