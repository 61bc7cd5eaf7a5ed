//! Makes a clean Debian 12 root, and runs commands in it. Each command runs in its own namespaces,
//! so that no mount and no process remains.

use std::fs;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use gdp_tests::netns::{Namespace, execute};
use gdp_tests::programs::{Executable as _, Program};
use gdp_tests::wait;
use tempfile::TempDir;

use super::cache::Cache;
use crate::shell;

/// The path of the tree in the root.
const CLONE: &str = "root/gdp";

const MIRROR: &str = "http://deb.debian.org";

/// Packages besides the base system, which are needed to clone the tree and to link Rust programs.
const PACKAGES: &str = "ca-certificates,gcc,git,libc6-dev";

/// The folder of additional certificates that this machine trusts. Cargo needs them for a registry
/// behind a proxy.
const CERTIFICATES: &str = "usr/local/share/ca-certificates";

/// A script that mounts what programs expect, in its own mount namespace, and runs its arguments in
/// the root. It stays the first process of its PID namespace, so its end kills all other processes
/// there. `$MOUNTS` has a line for each folder to mount: source, a tab, target.
const ENTER: &str = r#"
cd "$ROOT"
mount -t proc proc proc
mount -t sysfs sysfs sys
mount -t bpf bpf sys/fs/bpf
mount -t tmpfs -o mode=755 run run
mount -t tmpfs -o mode=755 dev dev
for node in null zero full random urandom tty; do
    touch "dev/$node"
    mount --bind "/dev/$node" "dev/$node"
done
mkdir dev/pts dev/shm
mount -t devpts -o newinstance,ptmxmode=0666 devpts dev/pts
mount -t tmpfs -o mode=1777 shm dev/shm
ln -s pts/ptmx dev/ptmx
ln -s /proc/self/fd dev/fd
ln -s fd/0 dev/stdin
ln -s fd/1 dev/stdout
ln -s fd/2 dev/stderr
mkdir -p "./$TOOLCHAIN"
mount --bind "$TOOLCHAIN" "./$TOOLCHAIN"
mount -o remount,bind,ro "./$TOOLCHAIN"
printf '%s' "$MOUNTS" | while IFS='	' read -r what where; do
    mkdir -p "$where"
    mount --bind "$what" "$where"
done
chroot . /usr/bin/env -i "$@"
"#;

pub struct Root {
    folder: Option<TempDir>,
    path: PathBuf,
    /// The toolchain that runs this xtask, which has the same path in the root.
    toolchain: PathBuf,
}

impl Root {
    pub fn make(cache: &Cache) -> Result<Self> {
        let toolchain = shell::output(Program::Rustc.command().args(["--print", "sysroot"]));
        let toolchain = PathBuf::from(toolchain.context("rustc does not tell where its toolchain is")?);
        let above = cache.roots();
        sweep(&above)?;
        let folder = tempfile::Builder::new().prefix(&format!("root-{}-", std::process::id())).tempdir_in(&above)?;
        let this = Self { path: folder.path().to_owned(), folder: Some(folder), toolchain };
        let mut debootstrap = Program::Debootstrap.command();
        debootstrap.args(["--variant=minbase", &format!("--include={PACKAGES}")]);
        debootstrap.arg(format!("--cache-dir={}", cache.debootstrap().display())).arg("bookworm").arg(this.path());
        debootstrap.arg(format!("{MIRROR}/debian"));
        // debootstrap also runs in its own namespaces, because it mounts and starts scripts of
        // daemons.
        let mut alone = alone();
        alone.arg(debootstrap.get_program()).args(debootstrap.get_args()).stdout(Stdio::null());
        run(&mut alone)?;
        this.configure()?;
        Ok(this)
    }

    fn configure(&self) -> Result<()> {
        let sources = format!(
            "deb {MIRROR}/debian bookworm main\ndeb {MIRROR}/debian bookworm-updates main\n\
             deb {MIRROR}/debian-security bookworm-security main\n"
        );
        self.write("etc/apt/sources.list", &sources)?;
        let own = Path::new("/").join(CERTIFICATES);
        for entry in fs::read_dir(&own).into_iter().flatten().flatten() {
            let to = self.path().join(CERTIFICATES).join(entry.file_name());
            fs::copy(entry.path(), &to).with_context(|| format!("cannot copy {}", entry.path().display()))?;
        }
        for file in ["etc/resolv.conf", "etc/hosts"] {
            // These files are optional.
            if let Ok(text) = fs::read_to_string(Path::new("/").join(file)) {
                self.write(file, &text)?;
            }
        }
        let mut update = alone();
        update.args([Program::Chroot.name()]).arg(self.path()).arg("/usr/sbin/update-ca-certificates");
        run(update.stdout(Stdio::null()))
    }

    fn write(&self, file: &str, text: &str) -> Result<()> {
        let file = self.path().join(file);
        fs::write(&file, text).with_context(|| format!("cannot write {}", file.display()))
    }

    fn path(&self) -> &Path {
        &self.path
    }

    pub fn clone_folder(&self) -> PathBuf {
        self.path().join(CLONE)
    }

    /// Runs a command in the clone, with this machine's network.
    pub fn online(&self, cache: &Cache, words: &[&str]) -> Result<()> {
        run(&mut self.command(cache, None, words)?)
    }

    /// Runs a command in the clone, in a network without a route to the outside.
    pub fn offline(&self, cache: &Cache, network: &Namespace, words: &[&str]) -> Result<()> {
        run(&mut self.command(cache, Some(network), words)?)
    }

    /// Runs a command like [`Root::online`] and returns its stdout.
    pub fn output(&self, cache: &Cache, words: &[&str]) -> Result<String> {
        execute(&mut self.command(cache, None, words)?)
    }

    /// Returns a command that runs in the clone.
    pub fn command(&self, cache: &Cache, network: Option<&Namespace>, words: &[&str]) -> Result<Command> {
        let mut command = match network {
            Some(network) => network.command(Program::Unshare)?,
            None => Program::Unshare.command(),
        };
        command.args(ALONE).args([Program::Sh.name(), "-ec", ENTER, Program::Sh.name()]);
        command.args(self.environment(network.is_some()));
        command
            .args([Program::Sh.name(), "-ec", &format!("cd /{CLONE} && exec \"$@\""), Program::Sh.name()])
            .args(words);
        let mounts = cache.mounts(CLONE).into_iter().map(|(from, to)| format!("{}\t{to}\n", from.display()));
        command.env("ROOT", self.path()).env("TOOLCHAIN", &self.toolchain).env("MOUNTS", mounts.collect::<String>());
        Ok(command)
    }

    /// Returns the environment of a login, with this machine's proxy settings.
    fn environment(&self, is_offline: bool) -> Vec<String> {
        let path = format!(
            "/root/.cargo/bin:{}/bin:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
            self.toolchain.display()
        );
        let mut all =
            vec![format!("PATH={path}"), "HOME=/root".into(), "LANG=C.UTF-8".into(), "RUST_BACKTRACE=1".into()];
        // Pip would otherwise use its own certificates.
        all.push("PIP_CERT=/etc/ssl/certs/ca-certificates.crt".into());
        if is_offline {
            all.push("CARGO_NET_OFFLINE=true".into());
        } else {
            let proxies = ["http_proxy", "https_proxy", "no_proxy", "HTTP_PROXY", "HTTPS_PROXY", "NO_PROXY"];
            all.extend(proxies.iter().filter_map(|name| Some(format!("{name}={}", std::env::var(name).ok()?))));
        }
        all
    }

    /// Removes the root. Fails if a mount or a process of it remains.
    pub fn remove(mut self) -> Result<()> {
        let path = self.path().to_owned();
        let processes = processes_in(&path);
        ensure!(processes.is_empty(), "processes are left in {}: {processes:?}", path.display());
        let mounts = fs::read_to_string("/proc/self/mountinfo").context("the mounts of this process")?;
        ensure!(!mounts.contains(&*path.to_string_lossy()), "{} has mounts left", path.display());
        let folder = self.folder.take().context("the root is there")?;
        folder.close().with_context(|| format!("cannot remove {}", path.display()))
    }
}

impl Drop for Root {
    fn drop(&mut self) {
        // Waits until processes that are being killed no longer write to the folder, which is
        // removed next.
        processes_in(&self.path);
    }
}

/// Options of `unshare` for separate namespaces. When it or its parent ends, all processes in them
/// end.
const ALONE: [&str; 6] = ["--mount", "--pid", "--fork", "--kill-child", "--uts", "--ipc"];

fn alone() -> Command {
    let mut command = Program::Unshare.command();
    command.args(ALONE);
    command
}

/// Runs a command to its end, and kills it on Ctrl-C.
fn run(command: &mut Command) -> Result<()> {
    // The terminal sends Ctrl-C to this process only.
    command.stdin(Stdio::null()).process_group(0);
    // SAFETY: prctl is async-signal-safe and touches no memory of ours.
    unsafe {
        command.pre_exec(|| match libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL) {
            0 => Ok(()),
            _ => Err(std::io::Error::last_os_error()),
        });
    }
    let mut child = Killed(command.spawn().context("cannot start unshare")?);
    loop {
        wait::check_interrupt()?;
        match child.0.try_wait()? {
            Some(status) if status.success() => return Ok(()),
            Some(status) => bail!("failed: {status}; what it printed says why"),
            None => std::thread::sleep(Duration::from_millis(50)),
        }
    }
}

struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        // An error because the process has already ended is ignored.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Returns the processes whose root is `folder`. Waits up to 10 s for processes that are being
/// killed.
fn processes_in(folder: &Path) -> Vec<PathBuf> {
    let deadline = Instant::now() + Duration::from_secs(10);
    loop {
        let all = fs::read_dir("/proc").into_iter().flatten().flatten().map(|entry| entry.path());
        let left: Vec<_> =
            all.filter(|process| fs::read_link(process.join("root")).is_ok_and(|root| root == folder)).collect();
        if left.is_empty() || Instant::now() > deadline {
            return left;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// Removes the roots of runs that were killed.
fn sweep(above: &Path) -> Result<()> {
    for entry in fs::read_dir(above).with_context(|| format!("cannot read {}", above.display()))?.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let pid = name.strip_prefix("root-").and_then(|rest| rest.split('-').next()?.parse::<u32>().ok());
        if pid.is_some_and(|pid| !Path::new(&format!("/proc/{pid}")).exists()) {
            let path = entry.path();
            fs::remove_dir_all(&path).with_context(|| format!("cannot remove {}", path.display()))?;
        }
    }
    Ok(())
}
