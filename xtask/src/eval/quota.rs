//! A share of one processor, by the kernel's control groups, as a slower computer has it.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result};
use gdp_tests::process::Process;

/// Period of the scheduler's quota. It is short, so that a program is slow and not stopped for
/// long.
const PERIOD_US: u32 = 10_000;

/// A control group. Dropping it removes the group, whose programs must have ended.
pub struct Quota(PathBuf);

impl Quota {
    /// Creates a group that gets this share of one processor.
    pub fn new(share: f64) -> Result<Self> {
        let root = Path::new("/sys/fs/cgroup");
        let is_unified = root.join("cgroup.controllers").exists();
        let parent = if is_unified { root.to_owned() } else { root.join("cpu") };
        let folder = parent.join(format!("gdp-eval-{}", std::process::id()));
        let quota = (f64::from(PERIOD_US) * share) as u32;
        let controllers = fs::read_to_string(parent.join("cgroup.subtree_control")).unwrap_or_default();
        if is_unified && !controllers.split_ascii_whitespace().any(|name| name == "cpu") {
            write(&parent.join("cgroup.subtree_control"), "+cpu")
                .context("the robot's share needs control groups with `cpu`")?;
        }
        let remedy =
            || format!("cannot create {}: the robot's share needs control groups with `cpu`", folder.display());
        fs::create_dir_all(&folder).with_context(remedy)?;
        let this = Self(folder);
        if is_unified {
            write(&this.0.join("cpu.max"), &format!("{quota} {PERIOD_US}"))?;
        } else {
            write(&this.0.join("cpu.cfs_period_us"), &PERIOD_US.to_string())?;
            write(&this.0.join("cpu.cfs_quota_us"), &quota.to_string())?;
        }
        Ok(this)
    }

    /// Moves a program with all its threads into the group.
    pub fn add(&self, process: &Process) -> Result<()> {
        write(&self.0.join("cgroup.procs"), &process.pid().to_string())
    }
}

impl Drop for Quota {
    fn drop(&mut self) {
        // The kernel may still be about to end the last program.
        for _ in 0..50 {
            if fs::remove_dir(&self.0).is_ok() {
                return;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        eprintln!("{} is left behind: `rmdir` removes it", self.0.display());
    }
}

fn write(file: &Path, text: &str) -> Result<()> {
    fs::write(file, text).with_context(|| format!("cannot write {text:?} to {}", file.display()))
}
