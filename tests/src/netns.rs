//! Network namespaces and veth pairs. Dropping the guard deletes them.
//!
//! Names are `gdp-PID-LABEL`. Tests can therefore run in parallel, and [`sweep`] recognises what a
//! killed run left behind.

use std::fs::File;
use std::marker::PhantomData;
use std::os::fd::AsRawFd;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};

use anyhow::{Context, Result, bail};

use crate::programs::{Executable, Program};

const PREFIX: &str = "gdp-";

/// A network namespace with `lo` up and IPv6 off. Dropping it deletes the namespace and its veths.
#[derive(Debug)]
pub struct Namespace {
    name: String,
    /// Whether this is the caller's own namespace, which nobody created here.
    is_own: bool,
}

impl Namespace {
    /// Creates a namespace. `label` is for people; the name is made unique.
    pub fn create(label: &str) -> Result<Self> {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let name = format!("{PREFIX}{}-{number}-{label}", std::process::id());
        ip(&["netns", "add", &name])?;
        let namespace = Self { name, is_own: false };
        {
            let _inside = namespace.enter()?;
            // Otherwise the kernel's own neighbour and router discovery mixes with the counted
            // frames.
            for scope in ["all", "default"] {
                std::fs::write(format!("/proc/sys/net/ipv6/conf/{scope}/disable_ipv6"), "1")
                    .with_context(|| format!("cannot turn IPv6 off in {}", namespace.name))?;
            }
        }
        namespace.ip(&["link", "set", "lo", "up"])?;
        Ok(namespace)
    }

    /// Returns the calling thread's namespace, in which commands start without root. It stays as it
    /// is when the handle is dropped.
    pub fn here() -> Self {
        Self { name: "the present namespace".into(), is_own: true }
    }

    /// Turns IPv6 on, for `lo` and future interfaces, without duplicate address detection.
    pub fn enable_ipv6(&self) -> Result<()> {
        let _inside = self.enter()?;
        for (setting, value) in [("accept_dad", "0"), ("router_solicitations", "0"), ("disable_ipv6", "0")] {
            for scope in ["all", "default", "lo"] {
                std::fs::write(format!("/proc/sys/net/ipv6/conf/{scope}/{setting}"), value)
                    .with_context(|| format!("cannot set {setting} in {}", self.name))?;
            }
        }
        Ok(())
    }

    pub fn name(&self) -> &str {
        &self.name
    }

    /// Runs `ip -n THIS …`.
    pub fn ip(&self, arguments: &[&str]) -> Result<String> {
        if self.is_own {
            return ip(arguments);
        }
        ip(&[&["-n", self.name.as_str()], arguments].concat())
    }

    /// Lets DDS programs in this namespace discover each other over `lo`.
    pub fn enable_loopback_multicast(&self) -> Result<()> {
        self.ip(&["link", "set", "lo", "multicast", "on"])?;
        self.ip(&["route", "add", "224.0.0.0/4", "dev", "lo"])?;
        Ok(())
    }

    /// Makes this namespace a router with NAT: connections from the interface `inside` leave under
    /// the router's address, and only replies return.
    pub fn masquerade(&self, inside: &str) -> Result<()> {
        {
            let _inside = self.enter()?;
            std::fs::write("/proc/sys/net/ipv4/ip_forward", "1").context("cannot turn on IP forwarding")?;
        }
        let rules = format!(
            "add table ip nat
             add chain ip nat out {{ type nat hook postrouting priority srcnat; }}
             add rule ip nat out oifname != \"{inside}\" masquerade
             add chain ip nat through {{ type filter hook forward priority filter; policy drop; }}
             add rule ip nat through ct state established,related accept
             add rule ip nat through iifname \"{inside}\" accept"
        );
        execute(self.command(Program::Nft)?.arg(rules)).map(drop)
    }

    /// Returns a command that runs its program in this namespace.
    pub fn command(&self, program: impl Executable) -> Result<Command> {
        if self.is_own {
            return Ok(program.command());
        }
        let namespace = self.open()?;
        let mut command = program.command();
        // SAFETY: setns on an open descriptor is async-signal-safe and allocates nothing.
        unsafe { command.pre_exec(move || set(&namespace)) };
        Ok(command)
    }

    /// Moves the calling thread into this namespace until the guard is dropped.
    pub fn enter(&self) -> Result<Entered> {
        self.door()?.enter()
    }

    /// Returns a handle with which another thread can enter this namespace.
    pub fn door(&self) -> Result<Door> {
        Ok(Door { namespace: self.open()?, name: self.name.clone() })
    }

    fn open(&self) -> Result<File> {
        let path = match self.is_own {
            true => PathBuf::from("/proc/thread-self/ns/net"),
            false => PathBuf::from("/run/netns").join(&self.name),
        };
        File::open(&path).with_context(|| format!("cannot open {}", path.display()))
    }
}

impl Drop for Namespace {
    fn drop(&mut self) {
        if self.is_own {
            return;
        }
        if let Err(error) = ip(&["netns", "del", &self.name]) {
            eprintln!("{error:#}");
        }
    }
}

/// A handle to a namespace that can be sent to another thread.
pub struct Door {
    namespace: File,
    name: String,
}

impl Door {
    /// Returns a handle to the calling thread's namespace.
    pub fn here() -> Result<Self> {
        let namespace = File::open("/proc/thread-self/ns/net").context("cannot open the present namespace")?;
        Ok(Self { namespace, name: "the present namespace".into() })
    }

    /// Moves the calling thread into the namespace until the guard is dropped.
    pub fn enter(&self) -> Result<Entered> {
        let before = File::open("/proc/thread-self/ns/net").context("cannot open the present namespace")?;
        set(&self.namespace).with_context(|| format!("cannot enter {} (root?)", self.name))?;
        Ok(Entered { before, _stays_on_its_thread: PhantomData })
    }
}

/// A guard while the calling thread is inside a namespace. `!Send`: namespaces belong to threads.
#[must_use = "dropping it leaves the namespace"]
pub struct Entered {
    before: File,
    _stays_on_its_thread: PhantomData<*const ()>,
}

impl Drop for Entered {
    fn drop(&mut self) {
        // A thread that cannot return would test in the wrong network, so the process panics.
        set(&self.before).expect("return to the namespace this thread came from");
    }
}

/// One end of a veth pair before its creation.
pub struct End<'a> {
    pub namespace: &'a Namespace,
    pub interface: &'a str,
    pub mac: [u8; 6],
}

/// Connects two namespaces. Transmit offloads are off: XDP sees complete frames. GRO is on, because
/// a veth drops redirected frames unless its peer has GRO or an XDP program.
pub fn veth(a: &End, b: &End, mtu: u32) -> Result<()> {
    let (mtu, mac_a, mac_b) = (mtu.to_string(), mac(a.mac), mac(b.mac));
    ip(&[
        "link",
        "add",
        a.interface,
        "netns",
        a.namespace.name(),
        "mtu",
        &mtu,
        "address",
        &mac_a,
        "type",
        "veth",
        "peer",
        "name",
        b.interface,
        "netns",
        b.namespace.name(),
        "mtu",
        &mtu,
        "address",
        &mac_b,
    ])?;
    for end in [a, b] {
        end.namespace.ip(&["link", "set", end.interface, "up"])?;
    }
    // The kernel notices that the other end accepts redirected frames only when GRO changes on a
    // running interface.
    for end in [a, b] {
        let mut ethtool = end.namespace.command(Program::Ethtool)?;
        execute(ethtool.args(["-K", end.interface, "tx", "off", "gro", "on"]))?;
    }
    Ok(())
}

/// Leaves checksums and segmentation of what an interface sends to the (virtual) hardware.
pub fn enable_transmit_offloads(end: &End) -> Result<()> {
    let mut ethtool = end.namespace.command(Program::Ethtool)?;
    execute(ethtool.args(["-K", end.interface, "tx", "on", "sg", "on", "tso", "on", "gso", "on"])).map(drop)
}

/// Deletes namespaces of runs whose process has ended.
pub fn sweep() -> Result<()> {
    for entry in std::fs::read_dir("/run/netns").into_iter().flatten().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let pid =
            name.strip_prefix(PREFIX).and_then(|rest| rest.split('-').next()).and_then(|pid| pid.parse::<u32>().ok());
        if pid.is_some_and(|pid| !PathBuf::from(format!("/proc/{pid}")).exists()) {
            ip(&["netns", "del", &name])?;
        }
    }
    Ok(())
}

/// Runs a command to its end. The error contains the command's stderr.
pub fn execute(command: &mut Command) -> Result<String> {
    let output = command.output().with_context(|| format!("cannot start {:?}", command.get_program()))?;
    if !output.status.success() {
        bail!("{command:?}: {}\n{}", output.status, String::from_utf8_lossy(&output.stderr).trim());
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

fn ip(arguments: &[&str]) -> Result<String> {
    execute(Program::Ip.command().args(arguments))
}

fn set(namespace: &File) -> std::io::Result<()> {
    // SAFETY: the descriptor is open for the length of the call.
    match unsafe { libc::setns(namespace.as_raw_fd(), libc::CLONE_NEWNET) } {
        0 => Ok(()),
        _ => Err(std::io::Error::last_os_error()),
    }
}

fn mac(bytes: [u8; 6]) -> String {
    bytes.map(|b| format!("{b:02x}")).join(":")
}
