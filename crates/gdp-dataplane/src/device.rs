//! One interface as the kernel describes it: state, driver, offloads, and the XDP program on it,
//! whoever's. Only asks. For [`crate::Planes`], which says whose program is in its way, and for
//! `gdp-ctl doctor`.

use std::collections::{HashMap, HashSet};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::sync::OnceLock;
use std::{fmt, io};

use aya::programs::links::LinkType;
use aya::programs::{loaded_links, loaded_programs};

use super::capabilities::{SYS_ADMIN, missing};
use super::netlink::{Netlink, attribute, number};
use crate::attach_mode::Mode;

/// Of an `ifinfomsg`.
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
    /// Whether the cable, or the other end, is there.
    pub running: bool,
    pub mtu: u32,
    /// `veth`, `bridge`, `vlan`, …; empty for hardware.
    pub kind: String,
    /// The interface that a VLAN is on.
    pub lower: Option<u32>,
    pub program: Option<AttachedProgram>,
}

/// An XDP program on an interface.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AttachedProgram {
    pub interface: String,
    pub id: u32,
    /// Its first 15 characters; empty if the kernel does not say.
    pub name: String,
    pub mode: Mode,
    /// Whether a BPF link holds it, and not the interface itself; `None` if the kernel does not
    /// say.
    pub by_link: Option<bool>,
}

/// What the hardware, or who plays it, does to packets before XDP or after; `None` where the driver
/// does not say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Offloads {
    pub lro: Option<bool>,
    pub tx_checksum: Option<bool>,
    pub rx_vlan: Option<bool>,
}

impl Device {
    /// In the calling thread's network namespace.
    pub fn find(ifindex: u32) -> io::Result<Self> {
        parse(&ask(ifindex)?).ok_or_else(|| io::ErrorKind::InvalidData.into())
    }

    /// [`Self::running`], without a look at anything else.
    #[cfg(feature = "dpdk")]
    pub fn is_running(ifindex: u32) -> io::Result<bool> {
        let flags = flags(&ask(ifindex)?).ok_or(io::ErrorKind::InvalidData)?;
        Ok(flags & libc::IFF_RUNNING as u32 != 0)
    }

    /// All there are, in the order of their indices.
    pub fn list() -> io::Result<Vec<Self>> {
        // SAFETY: no arguments; the list is freed below.
        let names = unsafe { libc::if_nameindex() };
        if names.is_null() {
            return Err(io::Error::last_os_error());
        }
        let mut indices = Vec::new();
        let mut entry = names;
        // SAFETY: the list ends with an entry of index 0, and nobody else has it.
        while let Some(index) = Some(unsafe { (*entry).if_index }).filter(|index| *index != 0) {
            indices.push(index);
            // SAFETY: not the last entry.
            entry = unsafe { entry.add(1) };
        }
        // SAFETY: what if_nameindex returned, once.
        unsafe { libc::if_freenameindex(names) };
        // One may be gone meanwhile.
        let found = indices.into_iter().map(Self::find);
        found.filter(|device| !matches!(device, Err(error) if error.raw_os_error() == Some(libc::ENODEV))).collect()
    }

    pub fn offloads(&self) -> io::Result<Offloads> {
        Offloads::of(&self.name)
    }
}

impl AttachedProgram {
    /// Whether it is a GDP switch.
    pub fn is_switch(&self) -> bool {
        self.name.starts_with("gdp_switch")
    }

    /// What takes it off.
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

/// Turns generic receive offload on. A veth takes redirected frames for its other end only if that
/// has it (or a program).
pub fn set_gro(interface: &str) -> io::Result<()> {
    const ETHTOOL_SGRO: u32 = 0x2c;
    let socket = socket()?;
    match ethtool(&socket, interface, [ETHTOOL_SGRO, 1]) {
        Some(_) => Ok(()),
        None => Err(io::Error::last_os_error()),
    }
}

/// The driver of an interface as `ethtool -i` names it; `None` if it does not say.
pub fn driver(interface: &str) -> Option<String> {
    /// `struct ethtool_drvinfo`, with what follows the name left as it is.
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
    // SAFETY: no pointers; the descriptor is owned at once.
    unsafe {
        match libc::socket(libc::AF_INET, libc::SOCK_DGRAM | libc::SOCK_CLOEXEC, 0) {
            -1 => Err(io::Error::last_os_error()),
            fd => Ok(OwnedFd::from_raw_fd(fd)),
        }
    }
}

/// The value that the driver has after a command with one; `None` if it does not know the command,
/// or refuses.
fn ethtool(socket: &OwnedFd, interface: &str, mut value: [u32; 2]) -> Option<u32> {
    // These commands read and write eight bytes.
    ioctl(socket, interface, value.as_mut_ptr().cast()).then_some(value[1])
}

/// Gives the driver a command, whether it was taken. `data`: what that command reads and writes.
fn ioctl(socket: &OwnedFd, interface: &str, data: *mut libc::c_char) -> bool {
    const SIOCETHTOOL: libc::c_ulong = 0x8946;
    // SAFETY: zero is a valid value of this structure.
    let mut request: libc::ifreq = unsafe { std::mem::zeroed() };
    // The last byte stays 0.
    let room = &mut request.ifr_name[..libc::IFNAMSIZ - 1];
    if interface.len() > room.len() {
        return false;
    }
    room.iter_mut().zip(interface.bytes()).for_each(|(to, byte)| *to = byte as libc::c_char);
    request.ifr_ifru.ifru_data = data;
    // SAFETY: the request points to what the command reads and writes, which outlives the call.
    unsafe { libc::ioctl(socket.as_raw_fd(), SIOCETHTOOL as _, &raw mut request) == 0 }
}

/// What the kernel says of an interface: an `ifinfomsg`, then attributes.
pub(super) fn ask(ifindex: u32) -> io::Result<Vec<u8>> {
    let skip = (IFLA_EXT_MASK, &RTEXT_FILTER_SKIP_STATS.to_ne_bytes()[..]);
    Netlink::open(libc::NETLINK_ROUTE)?.ask(libc::RTM_GETLINK, &header(ifindex), &[skip])
}

/// The `ifinfomsg` of a question about an interface, or of a change of it.
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
        // In hardware, then.
        None => (number(xdp, IFLA_XDP_PROG_ID)?, Mode::Native),
    };
    let (name, by_link) = match missing(&[SYS_ADMIN])[..] {
        [] => programs().remove(&id),
        _ => SEEN.get().and_then(|seen| seen.get(&id).cloned()),
    }
    .unzip();
    Some(AttachedProgram { interface: interface.to_owned(), id, name: name.unwrap_or_default(), mode, by_link })
}

/// The programs in the kernel, by number: their name, and whether a BPF link holds them to an
/// interface.
type Programs = HashMap<u32, (String, bool)>;

/// Those that were there when this process could still ask.
static SEEN: OnceLock<Programs> = OnceLock::new();

/// Keeps in mind the programs that are there now: without CAP_SYS_ADMIN the kernel does not name
/// them.
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
