//! Machines with a network, a root folder and terminals of their own.

use std::collections::BTreeMap;
use std::fs::File;
use std::os::fd::AsRawFd as _;
use std::os::unix::fs::PermissionsExt as _;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use gdp_tests::Tools;
use gdp_tests::netns::{End, Namespace, veth};
use gdp_tests::process::Process;
use gdp_tests::programs::Program;
use gdp_tests::wait::TIMEOUT;

use super::terminal::Terminal;

/// Gives the shell files of its own, says so, and keeps them until it is killed. `$1` is an empty
/// folder.
const OWN_FILES: &str = "set -e
cp -a /etc \"$1/etc\"
rm -rf \"$1/etc/gdp\"
mkdir \"$1/lib\"
mount --bind \"$1/etc\" /etc
mount --bind \"$1/lib\" /var/lib
mount -t tmpfs none /run
mount -t tmpfs none /root
echo ready
exec sleep infinity";

/// The machines of a page.
pub struct Site {
    machines: BTreeMap<String, Machine>,
    _internet: Namespace,
    _folder: tempfile::TempDir,
}

pub struct Machine {
    // Fields drop in this order: programs, network.
    running: Vec<Terminal>,
    files: Process,
    namespace: Namespace,
    _nat: Option<Namespace>,
    path: String,
    own: PathBuf,
}

impl Site {
    /// Creates the machines. The server has an address that all reach, and the others are behind
    /// NAT.
    pub fn build(labels: &[&str]) -> Result<Self> {
        let (folder, tools) = (tempfile::tempdir()?, Tools::beside_this_test()?);
        let internet = Namespace::create("internet")?;
        forward(&internet)?;
        let path = programs(folder.path(), &tools)?;
        let mut machines = BTreeMap::new();
        for (number, label) in (1..).zip(labels) {
            let (namespace, nat) = match *label {
                "server" => (server(&internet)?, None),
                label => member(label, &internet, number)?,
            };
            namespace.enable_loopback_multicast()?;
            let own = folder.path().join(label);
            machines.insert((*label).to_owned(), Machine::new(namespace, nat, path.clone(), own)?);
        }
        Ok(Self { machines, _internet: internet, _folder: folder })
    }

    pub fn machine(&mut self, label: &str) -> Result<&mut Machine> {
        self.machines.get_mut(label).with_context(|| format!("there is no machine {label}"))
    }
}

impl Machine {
    fn new(namespace: Namespace, nat: Option<Namespace>, path: String, own: PathBuf) -> Result<Self> {
        std::fs::create_dir(&own)?;
        let mut command = namespace.command(Program::Unshare)?;
        command.args(["--mount", "--propagation", "private", "sh", "-c", OWN_FILES, "sh"]).arg(&own);
        let mut files = Process::spawn("files", command, &own)?;
        files.wait_until("own files", TIMEOUT, |files| files.stdout().contains("ready").then_some(()))?;
        Ok(Self { running: Vec::new(), files, namespace, _nat: nat, path, own })
    }

    /// Opens a terminal, and types a command into it.
    pub fn open(&self, command: &str) -> Result<Terminal> {
        let mut shell = self.namespace.command(Program::Sh)?;
        shell.arg("-c").arg(format!("cd /root\n{command}"));
        shell.env("PATH", &self.path).env("HOME", "/root").env("USER", "anna").env("TERM", "dumb");
        // Fast DDS programs of several machines would otherwise meet in shared memory.
        shell.env("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4").env("ROS_LOG_DIR", &self.own);
        let files = File::open(format!("/proc/{}/ns/mnt", self.files.pid())).context("the machine's files")?;
        // SAFETY: setns on an open descriptor is async-signal-safe and allocates nothing.
        unsafe {
            shell.pre_exec(move || match libc::setns(files.as_raw_fd(), libc::CLONE_NEWNS) {
                0 => Ok(()),
                _ => Err(std::io::Error::last_os_error()),
            });
        }
        Terminal::open(shell)
    }

    /// Leaves a terminal open until the machine is gone.
    pub fn keep(&mut self, terminal: Terminal) {
        self.running.push(terminal);
    }

    /// Writes a file into the folder in which commands are typed.
    pub fn write(&self, name: &str, text: &str) -> Result<()> {
        let file = format!("/proc/{}/root/root/{name}", self.files.pid());
        std::fs::write(&file, text).with_context(|| format!("cannot write {file}"))
    }
}

fn server(internet: &Namespace) -> Result<Namespace> {
    let server = Namespace::create("server")?;
    connect((internet, "s0", "203.0.113.1/24"), (&server, "eth0", "203.0.113.7/24"), 0)?;
    server.ip(&["route", "add", "default", "via", "203.0.113.1"])?;
    Ok(server)
}

fn member(label: &str, internet: &Namespace, number: u8) -> Result<(Namespace, Option<Namespace>)> {
    let (inside, nat) = (Namespace::create(label)?, Namespace::create("nat")?);
    connect((&inside, "wlan0", "192.168.5.7/24"), (&nat, "i0", "192.168.5.1/24"), 2 * number)?;
    let outside = format!("10.77.{number}");
    let (near, far) = (format!("{outside}.2/24"), format!("{outside}.1/24"));
    connect((internet, &format!("m{number}"), &far), (&nat, "o0", &near), 2 * number + 1)?;
    inside.ip(&["route", "add", "default", "via", "192.168.5.1"])?;
    nat.ip(&["route", "add", "default", "via", &format!("{outside}.1")])?;
    nat.masquerade("i0")?;
    Ok((inside, Some(nat)))
}

/// Connects two namespaces by interfaces with addresses.
fn connect(a: (&Namespace, &str, &str), b: (&Namespace, &str, &str), cable: u8) -> Result<()> {
    let end = |(namespace, interface, _), side| End { namespace, interface, mac: [2, 0, 0, 0, cable, side] };
    veth(&end(a, 1), &end(b, 2), 1500)?;
    for (namespace, interface, address) in [a, b] {
        namespace.ip(&["addr", "add", address, "dev", interface])?;
    }
    Ok(())
}

fn forward(namespace: &Namespace) -> Result<()> {
    let _inside = namespace.enter()?;
    std::fs::write("/proc/sys/net/ipv4/ip_forward", "1").context("cannot turn on IP forwarding")
}

/// Returns a `PATH` with this project's programs, and with stand-ins: `sudo`, as the tests are root
/// already, and `ros2`, of which there is no package for Debian.
fn programs(folder: &Path, tools: &Tools) -> Result<String> {
    let bin = folder.join("bin");
    std::fs::create_dir(&bin)?;
    let ros2 = format!("exec {} {} \"$@\"", tools.python()?.display(), tools.peer("ros2.py").display());
    for (name, text) in [("sudo", "exec \"$@\""), ("ros2", &ros2)] {
        let file = bin.join(name);
        std::fs::write(&file, format!("#!/bin/sh\n{text}\n"))?;
        std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o755))?;
    }
    let own = tools.gdp_ctl()?;
    let own = own.parent().context("the folder of the programs")?;
    Ok(format!("{}:{}:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin", bin.display(), own.display()))
}
