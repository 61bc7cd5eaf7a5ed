//! Collects the facts from the system. Attaches nothing and leaves nothing behind: it unloads the
//! eBPF object and closes the port again.

use std::ffi::CString;
use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

use super::facts::{
    Bpffs, Clock, Dpdk, DpdkDevice, DpdkPort, Facts, Interface, LeftOver, Loaded, Owner, PortState, UdpFacts, Wanted,
};
use crate::config::{Config, DataPlane};
use gdp_dataplane::capabilities::{self, Capability, SYS_ADMIN};
use gdp_dataplane::device::Device;
use gdp_dataplane::dpdk::DpdkConfig;
use gdp_dataplane::kernel::KernelPlane;
use gdp_dataplane::kernel_version::KernelVersion;
use gdp_dataplane::object::Object;
use gdp_dataplane::pins::{self, Pins, PinsError};
use gdp_dataplane::xdp_features::XdpFeatures;
use gdp_dataplane::{disturbance, host_pair, losses, udp};
use gdp_util::os;
use gdp_util::unix_time::unix_seconds;

/// Collects the facts for a daemon with this configuration, in this network namespace.
pub fn facts(config: &Config) -> Facts {
    let wanted = wanted(config);
    Facts {
        clock: clock(),
        wanted,
        dpdk: matches!(wanted, Wanted::Dpdk).then(|| dpdk(&config.dpdk)),
        kernel: KernelVersion::running(),
        missing_capabilities: capabilities::missing(needed(config)),
        losses: losses::net_devices().map(drop).map_err(|error| error.to_string()),
        bpffs: config.bpffs.as_deref().map(bpffs),
        object: match wanted {
            Wanted::Xdp => load(config),
            Wanted::Dpdk => Err("DPDK does without XDP".into()),
            Wanted::Userspace(why) => Err(why.into()),
        },
        left_over: config.bpffs.as_deref().map(left_over).unwrap_or_default(),
        udp: config.udp.map(udp),
        interfaces: interfaces(config, wanted).map_err(|error| format!("cannot ask for interfaces: {error}")),
    }
}

fn wanted(config: &Config) -> Wanted {
    match config.data_plane {
        DataPlane::Userspace => Wanted::Userspace("`data_plane: userspace` is configured"),
        DataPlane::Auto
            if config.named_interfaces().is_empty() && !capabilities::missing(needed(config)).is_empty() =>
        {
            Wanted::Userspace("this process lacks capabilities and no interface is named")
        }
        DataPlane::Dpdk => Wanted::Dpdk,
        DataPlane::Auto | DataPlane::Xdp => Wanted::Xdp,
    }
}

fn dpdk(config: &DpdkConfig) -> Dpdk {
    let all = Device::list().unwrap_or_default();
    let port = |port: &gdp_dataplane::dpdk::DpdkPort| DpdkPort {
        interface: port.interface.clone(),
        name: port.name().to_owned(),
        state: match (port.carrier(), port.pci()) {
            (Some(name), _) => {
                let found = all.iter().find(|device| device.name == name).cloned();
                DpdkDevice::Interface { name: name.to_owned(), found }
            }
            (None, Some(_)) => DpdkDevice::Card(card(port.name())),
            (None, None) => DpdkDevice::Other,
        },
    };
    Dpdk {
        built: cfg!(feature = "dpdk"),
        root: os::is_root(),
        huge_pages: config.huge_pages.then(free_huge_pages),
        ports: config.ports.iter().map(port).collect(),
    }
}

/// Returns the driver of the network card at this PCI address. Returns `None` if there is no such
/// card.
fn card(address: &str) -> Option<Option<String>> {
    let folder = Path::new("/sys/bus/pci/devices").join(address);
    let driver = || Some(std::fs::read_link(folder.join("driver")).ok()?.file_name()?.to_string_lossy().into_owned());
    folder.exists().then(driver)
}

fn free_huge_pages() -> u64 {
    let text = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let free = text.lines().find_map(|line| line.strip_prefix("HugePages_Free:"));
    free.and_then(|number| number.trim().parse().ok()).unwrap_or(0)
}

fn clock() -> Clock {
    // SAFETY: zero is a valid value, and requests no change.
    let mut state: libc::timex = unsafe { std::mem::zeroed() };
    // SAFETY: a structure that outlives the call.
    let result = unsafe { libc::adjtimex(&raw mut state) };
    Clock { unix: unix_seconds(), synchronised: result >= 0 && result != libc::TIME_ERROR }
}

/// Returns the capabilities that this configuration needs.
fn needed(config: &Config) -> &'static [Capability] {
    if config.named_interfaces().is_empty() { &capabilities::XDP } else { &capabilities::SWITCH }
}

fn bpffs(at: &Path) -> Bpffs {
    let path = at.display().to_string();
    if !pins::is_mounted(at) {
        let empty = std::fs::read_dir(at).map_or(true, |mut entries| entries.next().is_none());
        if !empty {
            return Bpffs::Occupied { path };
        }
        let namespace = |process: &str| std::fs::read_link(format!("/proc/{process}/ns/mnt")).ok();
        let private = namespace("1").is_some_and(|first| namespace("self") != Some(first));
        return Bpffs::Missing { path, may_mount: capabilities::missing(&[SYS_ADMIN]).is_empty(), private };
    }
    let writable = CString::new(at.as_os_str().as_bytes()).map_err(io::Error::from).and_then(|text| {
        // SAFETY: a C string that outlives the call.
        match unsafe { libc::access(text.as_ptr(), libc::W_OK | libc::X_OK) } {
            0 => Ok(()),
            _ => Err(io::Error::last_os_error()),
        }
    });
    match writable {
        Ok(()) => Bpffs::Mounted { path },
        Err(error) => Bpffs::ReadOnly { path, reason: error.to_string() },
    }
}

fn load(config: &Config) -> Result<Loaded, String> {
    let object = Object::find(config.ebpf_object.as_deref()).map_err(|error| error.to_string())?;
    let plane = KernelPlane::load(object.clone(), config.fib_capacity).map_err(|error| error.to_string())?;
    Ok(Loaded { object: object.to_string(), names: config.fib_capacity, jitted: plane.programs.is_jitted() })
}

fn left_over(bpffs: &Path) -> Vec<LeftOver> {
    let found = pins::find(bpffs).unwrap_or_default();
    let found = found.iter().map(|found| LeftOver {
        folder: found.folder.display().to_string(),
        abi: found.abi,
        daemon: matches!(Pins::of(found), Err(PinsError::InUse(_))),
        here: found.is_of_this_namespace(),
    });
    found.collect()
}

fn udp(address: SocketAddr) -> UdpFacts {
    let state = match UdpSocket::bind(address) {
        Ok(_) => PortState::Free,
        Err(error) if error.kind() != io::ErrorKind::AddrInUse => PortState::Refused(error.to_string()),
        Err(_) => match holder(address.port()) {
            Some((name, _)) if name == "gdp-ctl" => PortState::Daemon,
            Some((name, pid)) => PortState::Taken(Some(format!("{name} (process {pid})"))),
            None => PortState::Taken(None),
        },
    };
    UdpFacts { address, state, zero_checksum_v6: zero_checksum().map_err(|error| error.to_string()) }
}

/// Returns the program that holds a UDP port of this network namespace, if this process may see it.
fn holder(port: u16) -> Option<(String, u32)> {
    let tables = ["/proc/thread-self/net/udp", "/proc/thread-self/net/udp6"].map(std::fs::read_to_string);
    let inodes: Vec<String> = tables.iter().flatten().flat_map(|table| sockets_at(table, port)).collect();
    let processes = std::fs::read_dir("/proc").ok()?.flatten();
    processes.filter_map(|entry| Some((entry.file_name().to_str()?.parse().ok()?, entry.path()))).find_map(
        |(pid, path)| {
            let mut open = std::fs::read_dir(path.join("fd")).ok()?.flatten();
            open.find(|fd| {
                std::fs::read_link(fd.path())
                    .is_ok_and(|to| inodes.iter().any(|inode| to == Path::new(&format!("socket:[{inode}]"))))
            })?;
            Some((std::fs::read_to_string(path.join("comm")).ok()?.trim_end().to_owned(), pid))
        },
    )
}

/// Returns the inode numbers of the sockets at a local port, from a table of `/proc/net`.
fn sockets_at(table: &str, port: u16) -> impl Iterator<Item = String> {
    table.lines().filter_map(move |line| {
        let mut fields = line.split_whitespace();
        let (_, digits) = fields.nth(1)?.rsplit_once(':')?;
        (u16::from_str_radix(digits, 16) == Ok(port)).then(|| fields.nth(7).map(str::to_owned))?
    })
}

fn zero_checksum() -> io::Result<()> {
    const UDP_NO_CHECK6_RX: libc::c_int = 102;
    // SAFETY: no pointers; the descriptor is owned at once.
    let socket = unsafe {
        match libc::socket(libc::AF_INET6, libc::SOCK_DGRAM | libc::SOCK_CLOEXEC, 0) {
            -1 => return Err(io::Error::last_os_error()),
            fd => OwnedFd::from_raw_fd(fd),
        }
    };
    let (on, length) = (1i32, size_of::<i32>() as u32);
    // SAFETY: pointer and length are of one live integer.
    match unsafe {
        libc::setsockopt(socket.as_raw_fd(), libc::SOL_UDP, UDP_NO_CHECK6_RX, (&raw const on).cast(), length)
    } {
        0 => Ok(()),
        _ => Err(io::Error::last_os_error()),
    }
}

/// Returns the facts of the named interfaces, and of those with addresses for links over UDP, as
/// the daemon selects them. Leaves out missing interfaces of DPDK ports, which exist only while a
/// daemon runs.
fn interfaces(config: &Config, plane: Wanted) -> io::Result<Vec<Result<Interface, String>>> {
    let all = Device::list()?;
    let features = XdpFeatures::open().ok();
    let is_dpdk = config.data_plane == DataPlane::Dpdk;
    let is_port = |name: &str| is_dpdk && config.dpdk.ports.iter().any(|port| port.interface == name);
    let named = config.named_interfaces();
    let find = |name: &String| all.iter().find(|device| device.name == *name).ok_or_else(|| name.clone());
    let found = named.iter().map(find).filter(|found| !found.as_ref().is_err_and(|name| is_port(name)));
    let mut wanted: Vec<Result<&Device, String>> = found.collect();
    if let (Some(bound), Wanted::Xdp) = (config.udp, plane) {
        let taken = udp::taken_at(bound, udp::addresses()?);
        let by_udp = |device: &&Device| taken.iter().any(|(_, at)| at.interface == device.name);
        let by_udp = all.iter().filter(|device| device.ethernet && !host_pair::is_end(&device.name)).filter(by_udp);
        wanted.extend(by_udp.filter(|device| !named.contains(&device.name)).map(Ok));
    }
    let look = |device: &Device| {
        let features = features.as_ref().and_then(|features| features.of(device.index).ok());
        Ok(Interface {
            device: device.clone(),
            offloads: device.offloads()?,
            features,
            disturbed: disturbance::of(&device.name, features).filter(|_| !named.contains(&device.name)),
            owner: match &device.program {
                Some(program) if !program.is_switch() => Owner::Foreign,
                _ => Owner::Switch,
            },
            has_vlans: all.iter().any(|other| other.kind == "vlan" && other.lower == Some(device.index)),
        })
    };
    wanted.into_iter().map(|device| device.map_or_else(|name| Ok(Err(name)), |device| look(device).map(Ok))).collect()
}

#[cfg(test)]
#[path = "../../tests/unit/doctor/gather.rs"]
mod tests;
