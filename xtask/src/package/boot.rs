//! `cargo xtask package boot`: boots a Debian with the packages and its real systemd in a virtual
//! machine. A script in the machine uses the services as an administrator would, and prints what it
//! finds on the console.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use gdp_tests::netns::execute;
use gdp_tests::process::Process;
use gdp_tests::programs::{Executable as _, Program};
use gdp_tests::wait;

use super::build::{Build, folder};
use super::trial::{copy, remove, root, two_versions};
use crate::setup::{self, Purpose};
use crate::workspace::is_root;

/// What the machine runs after it has booted.
const SCRIPT: &str = include_str!("boot.sh");

/// Time for everything in the machine, without hardware to help.
const TIMEOUT: Duration = Duration::from_secs(1200);

/// Packages besides the base system.
const PACKAGES: &str = ",systemd,systemd-sysv,udev,kmod,dbus,man-db,linux-image-cloud-amd64";

pub fn run(build: &Build) -> Result<()> {
    ensure!(is_root(), "the machine's file system is made with debootstrap, which needs root");
    setup::ensure(Purpose::Boot)?;
    wait::catch_interrupts();
    let [old, new] = two_versions(build)?;
    let root = root("boot", PACKAGES)?;
    for (label, debs) in [("old", old), ("new", new)] {
        fs::create_dir_all(root.join("root").join(label))?;
        debs.iter().try_for_each(|deb| copy(deb, &root.join("root").join(label)))?;
    }
    fs::write(root.join("root/boot.sh"), SCRIPT)?;
    fs::write(root.join("etc/fstab"), "/dev/vda / ext4 defaults 0 1\n")?;
    fs::write(root.join("etc/hostname"), "gdp\n")?;
    fs::write(root.join("etc/hosts"), "127.0.0.1 localhost gdp\n")?;
    let unit = "[Unit]\nAfter=multi-user.target\n[Service]\nType=oneshot\nExecStart=/bin/bash /root/boot.sh\n\
                StandardOutput=tty\nStandardError=tty\nTTYPath=/dev/ttyS0\nTimeoutStartSec=infinity\n\
                [Install]\nWantedBy=multi-user.target\n";
    fs::write(root.join("etc/systemd/system/trial.service"), unit)?;
    let wants = root.join("etc/systemd/system/multi-user.target.wants");
    fs::create_dir_all(&wants)?;
    symlink("/etc/systemd/system/trial.service", wants.join("trial.service"))?;
    let (kernel, initrd) = (newest(&root.join("boot"), "vmlinuz-")?, newest(&root.join("boot"), "initrd.img-")?);
    let disk = folder().join("boot.ext4");
    let _ = fs::remove_file(&disk);
    execute(Program::Mke2fs.command().args(["-q", "-t", "ext4", "-d"]).arg(&root).arg(&disk).arg("3G"))?;
    let result = boot(&kernel, &initrd, &disk);
    remove(&root)?;
    fs::remove_file(&disk)?;
    result
}

fn boot(kernel: &Path, initrd: &Path, disk: &Path) -> Result<()> {
    let logs = tempfile::tempdir()?;
    let mut qemu = Program::QemuSystem.command();
    // Without KVM, so that it works wherever CI runs.
    qemu.args(["-M", "q35", "-accel", "tcg,thread=multi", "-cpu", "Nehalem", "-smp", "2", "-m", "2048", "-nographic"]);
    qemu.args(["-no-reboot", "-nic", "none", "-drive"]).arg(format!("file={},format=raw,if=virtio", disk.display()));
    qemu.arg("-kernel").arg(kernel).arg("-initrd").arg(initrd);
    qemu.args([
        "-append",
        "root=/dev/vda rw console=ttyS0 quiet systemd.show_status=0 systemd.getty_auto=0 net.ifnames=0",
    ]);
    let mut machine = Process::spawn("machine", qemu, logs.path())?;
    let (begun, mut shown) = (Instant::now(), 0);
    loop {
        wait::check_interrupt()?;
        let said = machine.stdout();
        print!("{}", said.get(shown..).unwrap_or_default());
        shown = said.len();
        if said.contains("THE TRIAL ENDS: good") {
            return Ok(());
        }
        if said.contains("THE TRIAL ENDS: failed") || machine.check_alive().is_err() {
            bail!("the services do not work in the machine; its console says why");
        }
        ensure!(begun.elapsed() < TIMEOUT, "the machine took more than {} s", TIMEOUT.as_secs());
        std::thread::sleep(Duration::from_millis(500));
    }
}

/// Returns the file in `folder` whose name begins so and is last in order.
fn newest(folder: &Path, prefix: &str) -> Result<PathBuf> {
    let found = fs::read_dir(folder)?.flatten().filter(|entry| entry.file_name().to_string_lossy().starts_with(prefix));
    let newest = found.map(|entry| entry.path()).max();
    newest.with_context(|| format!("{} has no {prefix}…", folder.display()))
}
