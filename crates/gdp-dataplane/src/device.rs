//! An interface as the kernel describes it: state, driver, offloads, and any attached XDP program.
//! This module only queries, except [`set_gro`]. [`crate::Planes`] uses it to report conflicting
//! programs, and `gdp-ctl doctor` uses it too.

use std::collections::{HashMap, HashSet};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::sync::OnceLock;
use std::{fmt, io};

use aya::programs::links::LinkType;
use aya::programs::{loaded_links, loaded_programs};

use super::capabilities::{SYS_ADMIN, missing};
use super::netlink::{Netlink, attribute, number};
use crate::attach_mode::Mode;

/// Length of an `ifinfomsg`.
pub(super) const HEADER: usize = 16;
const RTEXT_FILTER_SKIP_STATS: u32 = 1 << 3;
const IFLA_IFNAME: u16 = 3;
const IFLA_MTU: u16 = 4;
const IFLA_LINK: u16 = 5;
const IFLA_LINKINFO: u16 = 18;
const IFLA_INFO_KIND: u16 = 1;
const IFLA_EXT_MASK: u16 = 29;
const IFLA_XDP: u16 = 43;
const IFLA_XDP_PROG_ID: u16 = 4;
const IFLA_XDP_DRV_PROG_ID: u16 = 5;
const IFLA_XDP_SKB_PROG_ID: u16 = 6;

/// An interface of this network namespace.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Device {
    pub name: String,
    pub index: u32,
    /// Whether GDP can run on it directly.
    pub ethernet: bool,
    pub up: bool,
    /// Whether the carrier is present, or the peer is up.
    pub running: bool,
    pub mtu: u32,
    /// `veth`, `bridge`, `vlan`, …; empty for hardware.
    pub kind: String,
    /// Lower interface of a VLAN.
    pub lower: Option<u32>,
    pub program: Option<AttachedProgram>,
}

/// An XDP program on an interface.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AttachedProgram {
    pub interface: String,
    pub id: u32,
    /// First 15 characters of the name; empty if the kernel does not report it.
    pub name: String,
    pub mode: Mode,
    /// Whether a BPF link attaches it, rather than the interface itself; `None` if the kernel does
    /// not report it.
    pub by_link: Option<bool>,
}

/// Offloads that change packets before or after XDP; `None` where the driver does not report them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Offloads {
    pub lro: Option<bool>,
    pub tx_checksum: Option<bool>,
    pub rx_vlan: Option<bool>,
}

impl Device {
    /// Returns an interface in the calling thread's network namespace.
    pub fn find(ifindex: u32) -> io::Result<Self> {
        parse(&ask(ifindex)?).ok_or_else(|| io::ErrorKind::InvalidData.into())
    }

    /// Returns [`Self::running`] without querying anything else.
    #[cfg(feature = "dpdk")]
    pub fn is_running(ifindex: u32) -> io::Result<bool> {
        let flags = flags(&ask(ifindex)?).ok_or(io::ErrorKind::InvalidData)?;
        Ok(flags & libc::IFF_RUNNING as u32 != 0)
    }

    /// Returns all interfaces in the order of their indices.
    pub fn list() -> io::Result<Vec<Self>> {
        // SAFETY: the call has no arguments, and the list is freed below.
        let names = unsafe { libc::if_nameindex() };
        if names.is_null() {
            return Err(io::Error::last_os_error());
        }
        let mut indices = Vec::new();
        let mut entry = names;
        // SAFETY: the list ends with an entry of index 0, and no other code accesses it.
        while let Some(index) = Some(unsafe { (*entry).if_index }).filter(|index| *index != 0) {
            indices.push(index);
            // SAFETY: this is not the last entry.
            entry = unsafe { entry.add(1) };
        }
        // SAFETY: if_nameindex returned this list, and it is freed once.
        unsafe { libc::if_freenameindex(names) };
        // An interface may have been deleted meanwhile.
        let found = indices.into_iter().map(Self::find);
        found.filter(|device| !matches!(device, Err(error) if error.raw_os_error() == Some(libc::ENODEV))).collect()
    }

    pub fn offloads(&self) -> io::Result<Offloads> {
        Offloads::of(&self.name)
    }
}

impl AttachedProgram {
    /// Returns whether the program is a GDP switch.
    pub fn is_switch(&self) -> bool {
        self.name.starts_with("gdp_switch")
    }

    /// Returns instructions for detaching the program.
    pub fn remedy(&self) -> String {
        let (interface, id) = (&self.interface, self.id);
        let attribute = match self.mode {
            Mode::Native => "xdpdrv",
            Mode::Generic => "xdpgeneric",
        };
        match (self.is_switch(), self.by_link) {
            (true, _) => "stop the daemon that it belongs to; if none runs, `gdp-ctl xdp detach` removes it".into(),
            (_, Some(true)) => format!(
                "it goes with the program that attached it, or with that one's pin: `bpftool link` shows the link of \
                 program {id}, \
                 `bpftool link detach id LINK` removes it"
            ),
            (_, Some(false)) => format!("`ip link set dev {interface} {attribute} off` removes it"),
            (_, None) => format!("`bpftool net` and `bpftool link`, as root, show what holds program {id}"),
        }
    }
}

impl fmt::Display for AttachedProgram {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = if self.name.is_empty() { "without a name".to_owned() } else { format!("`{}`", self.name) };
        write!(f, "program {} {name}, in {} mode", self.id, self.mode.as_str())
    }
}

impl Offloads {
    fn of(interface: &str) -> io::Result<Self> {
        const ETHTOOL_GTXCSUM: u32 = 0x16;
        const ETHTOOL_GFLAGS: u32 = 0x25;
        const ETH_FLAG_RXVLAN: u32 = 1 << 8;
        const ETH_FLAG_LRO: u32 = 1 << 15;
        let socket = socket()?;
        let flags = ethtool(&socket, interface, [ETHTOOL_GFLAGS, 0]);
        Ok(Self {
            lro: flags.map(|flags| flags & ETH_FLAG_LRO != 0),
            tx_checksum: ethtool(&socket, interface, [ETHTOOL_GTXCSUM, 0]).map(|on| on != 0),
            rx_vlan: flags.map(|flags| flags & ETH_FLAG_RXVLAN != 0),
        })
    }
}

/// Turns generic receive offload on. A veth accepts redirected frames for its peer only if the peer
/// has GRO on or runs a program.
pub fn set_gro(interface: &str) -> io::Result<()> {
    const ETHTOOL_SGRO: u32 = 0x2c;
    let socket = socket()?;
    match ethtool(&socket, interface, [ETHTOOL_SGRO, 1]) {
        Some(_) => Ok(()),
        None => Err(io::Error::last_os_error()),
    }
}

/// Returns the driver of an interface as in `ethtool -i`; `None` if the driver does not report it.
pub fn driver(interface: &str) -> Option<String> {
    /// `struct ethtool_drvinfo`; the fields after the name are unused.
    #[repr(C)]
    struct DriverInfo {
        command: u32,
        driver: [u8; 32],
        rest: [u8; 160],
    }
    const ETHTOOL_GDRVINFO: u32 = 0x3;
    let mut info = DriverInfo { command: ETHTOOL_GDRVINFO, driver: [0; 32], rest: [0; 160] };
    if !ioctl(&socket().ok()?, interface, (&raw mut info).cast()) {
        return None;
    }
    let name = info.driver.split(|byte| *byte == 0).next().unwrap_or_default();
    Some(String::from_utf8_lossy(name).into_owned()).filter(|name| !name.is_empty())
}

fn socket() -> io::Result<OwnedFd> {
    // SAFETY: the call takes no pointers, and the descriptor is owned immediately.
    unsafe {
        match libc::socket(libc::AF_INET, libc::SOCK_DGRAM | libc::SOCK_CLOEXEC, 0) {
            -1 => Err(io::Error::last_os_error()),
            fd => Ok(OwnedFd::from_raw_fd(fd)),
        }
    }
}

/// Returns the driver's value after a command with a value; `None` if the driver does not know or
/// refuses the command.
fn ethtool(socket: &OwnedFd, interface: &str, mut value: [u32; 2]) -> Option<u32> {
    // These commands read and write eight bytes.
    ioctl(socket, interface, value.as_mut_ptr().cast()).then_some(value[1])
}

/// Sends a command to the driver. Returns whether it succeeded. `data`: memory that the command
/// reads and writes.
fn ioctl(socket: &OwnedFd, interface: &str, data: *mut libc::c_char) -> bool {
    const SIOCETHTOOL: libc::c_ulong = 0x8946;
    // SAFETY: zero is a valid value of this structure.
    let mut request: libc::ifreq = unsafe { std::mem::zeroed() };
    // The last byte remains 0.
    let room = &mut request.ifr_name[..libc::IFNAMSIZ - 1];
    if interface.len() > room.len() {
        return false;
    }
    room.iter_mut().zip(interface.bytes()).for_each(|(to, byte)| *to = byte as libc::c_char);
    request.ifr_ifru.ifru_data = data;
    // SAFETY: the request points to memory that the command reads and writes, which outlives the
    // call.
    unsafe { libc::ioctl(socket.as_raw_fd(), SIOCETHTOOL as _, &raw mut request) == 0 }
}

/// Returns the kernel's description of an interface: an `ifinfomsg`, then attributes.
pub(super) fn ask(ifindex: u32) -> io::Result<Vec<u8>> {
    let skip = (IFLA_EXT_MASK, &RTEXT_FILTER_SKIP_STATS.to_ne_bytes()[..]);
    Netlink::open(libc::NETLINK_ROUTE)?.ask(libc::RTM_GETLINK, &header(ifindex), &[skip])
}

/// Returns the `ifinfomsg` of a query or change of an interface.
pub(super) fn header(ifindex: u32) -> [u8; HEADER] {
    let mut header = [0; HEADER];
    header[4..8].copy_from_slice(&ifindex.to_ne_bytes());
    header
}

fn flags(answer: &[u8]) -> Option<u32> {
    Some(u32::from_ne_bytes(*answer.get(8..)?.first_chunk()?))
}

fn parse(answer: &[u8]) -> Option<Device> {
    let kind = u16::from_ne_bytes(*answer.get(2..)?.first_chunk()?);
    let index = u32::from_ne_bytes(*answer.get(4..)?.first_chunk()?);
    let flags = flags(answer)?;
    let has = |flag: libc::c_int| flags & flag as u32 != 0;
    let attributes = answer.get(HEADER..)?;
    let text = |value: &[u8]| String::from_utf8_lossy(value.split(|b| *b == 0).next().unwrap_or_default()).into_owned();
    let name = text(attribute(attributes, IFLA_IFNAME)?);
    let info = attribute(attributes, IFLA_LINKINFO).and_then(|info| attribute(info, IFLA_INFO_KIND));
    Some(Device {
        index,
        ethernet: kind == libc::ARPHRD_ETHER && !has(libc::IFF_LOOPBACK),
        up: has(libc::IFF_UP),
        running: has(libc::IFF_RUNNING),
        mtu: number(attributes, IFLA_MTU)?,
        kind: info.map(text).unwrap_or_default(),
        lower: number(attributes, IFLA_LINK).filter(|lower| *lower != index),
        program: attribute(attributes, IFLA_XDP).and_then(|xdp| program(&name, xdp)),
        name,
    })
}

fn program(interface: &str, xdp: &[u8]) -> Option<AttachedProgram> {
    let native = number(xdp, IFLA_XDP_DRV_PROG_ID);
    let (id, mode) = match native.or_else(|| number(xdp, IFLA_XDP_SKB_PROG_ID)) {
        Some(id) => (id, if native.is_some() { Mode::Native } else { Mode::Generic }),
        // The program runs in hardware.
        None => (number(xdp, IFLA_XDP_PROG_ID)?, Mode::Native),
    };
    let (name, by_link) = match missing(&[SYS_ADMIN])[..] {
        [] => programs().remove(&id),
        _ => SEEN.get().and_then(|seen| seen.get(&id).cloned()),
    }
    .unzip();
    Some(AttachedProgram { interface: interface.to_owned(), id, name: name.unwrap_or_default(), mode, by_link })
}

/// The programs in the kernel by id, each with its name and whether a BPF link attaches it to an
/// interface.
type Programs = HashMap<u32, (String, bool)>;

/// The programs that [`remember_programs`] recorded.
static SEEN: OnceLock<Programs> = OnceLock::new();

/// Records the current programs. Without CAP_SYS_ADMIN the kernel does not report their names.
pub fn remember_programs() {
    SEEN.get_or_init(programs);
}

fn programs() -> Programs {
    let links = loaded_links().flatten().filter(|link| link.link_type().is_ok_and(|kind| kind == LinkType::Xdp));
    let linked: HashSet<u32> = links.map(|link| link.program_id()).collect();
    let described = loaded_programs().flatten().map(|program| {
        let name = program.name_as_str().map(str::to_owned).unwrap_or_default();
        (program.id(), (name, linked.contains(&program.id())))
    });
    described.collect()
}

#[cfg(test)]
#[path = "../tests/unit/device.rs"]
mod tests;
