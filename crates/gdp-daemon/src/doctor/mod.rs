//! Checks whether a daemon would find what it needs on this host, and suggests remedies. Pure.
//!
//! [`facts`] has the facts, [`examine`] judges them, and [`gather`] collects them from the system.
//! `gdp-ctl doctor` calls them.
//!
//! A *failure* keeps the daemon from running as configured, on an interface or at all. A *warning*
//! makes it slower or loses frames later.

pub mod facts;
pub mod gather;

use gdp_wire::table::ABI;
use schemars::JsonSchema;
use serde::Serialize;

use facts::{
    Bpffs, Clock, Dpdk, DpdkDevice, DpdkPort, Facts, Interface, LeftOver, Loaded, Owner, PortState, UdpFacts, Wanted,
};
use gdp_dataplane::kernel_failures::FLOOR;
use gdp_dataplane::kernel_version::KernelVersion;

/// The first kernel whose XDP accepts packets in several buffers.
const FRAGS: KernelVersion = KernelVersion(5, 18);
/// The first kernel that reports the XDP features of an interface.
const FEATURES: KernelVersion = KernelVersion(6, 3);

/// The largest MTU at which a veth accepts a program for single-buffer packets, in bytes.
const ONE_BUFFER: u32 = 3506;
/// The smallest MTU, in bytes: an initial QUIC datagram of 1200 bytes, with IPv6 and UDP headers.
const SMALLEST_MTU: u32 = 1248;
/// The bytes prepended to a frame from Ethernet to UDP over IPv6 on a VLAN.
const ENCAPSULATION: u32 = 40 + 8 + 4;

/// The plausible range of the clock, in Unix seconds: 2025-01-01 to 2100-01-01.
const SANE: std::ops::Range<u64> = 1_735_689_600..4_102_444_800;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    Ok,
    Warning,
    Failed,
}

impl Level {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Warning => "warning",
            Self::Failed => "failed",
        }
    }
}

/// The outcome of one check.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Finding {
    pub check: &'static str,
    /// The interface that the check is about, if any.
    pub interface: Option<String>,
    pub level: Level,
    /// The fact that the check found.
    pub fact: String,
    /// The remedy, if one is needed.
    pub remedy: Option<String>,
}

/// Runs all checks, in a fixed order.
pub fn examine(facts: &Facts) -> Vec<Finding> {
    let mut findings = vec![clock(&facts.clock)];
    match facts.wanted {
        Wanted::Userspace(why) => {
            findings.push(ok("data plane", format!("in user space, because {why}: XDP is not looked at")))
        }
        Wanted::Dpdk => findings.extend(facts.dpdk.iter().flat_map(dpdk)),
        Wanted::Xdp => findings.extend(kernel(facts)),
    }
    findings.extend(facts.left_over.iter().map(left_over));
    findings.extend(facts.udp.iter().flat_map(udp));
    match &facts.interfaces {
        Err(error) => findings.push(failed("interfaces", error.clone(), "run this where netlink may be used")),
        Ok(found) => {
            let any_native = found.iter().flatten().any(|interface| interface.features.is_none_or(|f| f.native()));
            for interface in found {
                findings.extend(match interface {
                    Err(name) => vec![Finding {
                        interface: Some(name.clone()),
                        ..failed(
                            "interface",
                            "there is none of this name".into(),
                            "`ip link` names them; correct `interfaces`",
                        )
                    }],
                    Ok(interface) => one_interface(interface, facts, any_native),
                });
            }
        }
    }
    findings
}

fn dpdk(dpdk: &Dpdk) -> Vec<Finding> {
    let mut findings = vec![match (dpdk.built, dpdk.root) {
        (false, _) => failed(
            "data plane",
            "`data_plane: dpdk` is configured, and this gdp-ctl was built without the feature `dpdk`".into(),
            "`cargo build -p gdp-ctl --features dpdk`, or set `data_plane: auto`",
        ),
        (_, false) => failed("data plane", "DPDK, and this is not root".into(), "run the daemon as root"),
        _ => ok("data plane", "DPDK, on the devices below: XDP is not looked at".into()),
    }];
    findings.extend(dpdk.huge_pages.map(|free| match free {
        0 => failed("huge pages", "none is free".into(), "`sysctl vm.nr_hugepages=256`"),
        free => ok("huge pages", format!("{free} are free")),
    }));
    findings.extend(dpdk.ports.iter().map(dpdk_port));
    findings
}

fn dpdk_port(port: &DpdkPort) -> Finding {
    let name = &port.name;
    let finding = match &port.state {
        DpdkDevice::Interface { name: of, found: None } => failed(
            "device",
            format!("{name}: there is no interface {of}"),
            "`ip link` names them; correct `iface=` in `dpdk.ports`",
        ),
        DpdkDevice::Interface { name: of, found: Some(device) } => match (device.up, device.running) {
            (false, _) => failed("device", format!("{name}: {of} is down"), format!("`ip link set dev {of} up`")),
            (_, false) => warning(
                "device",
                format!("{name}: {of} is up, without a carrier"),
                "plug it in, or bring its other end up",
            ),
            _ => ok("device", format!("{name}: {of} is up")),
        },
        DpdkDevice::Card(None) => failed(
            "device",
            format!("{name}: there is no such card"),
            "`lspci -D` names them; correct `device` in `dpdk.ports`",
        ),
        DpdkDevice::Card(Some(driver)) if driver.as_deref() == Some("vfio-pci") => {
            ok("device", format!("{name} is bound to vfio-pci"))
        }
        // Some DPDK drivers work with another kernel driver.
        DpdkDevice::Card(Some(driver)) => warning(
            "device",
            format!(
                "{name} is bound to {}, and most drivers of DPDK's want vfio-pci",
                driver.as_deref().unwrap_or("nothing")
            ),
            format!("`dpdk-devbind.py --bind=vfio-pci {name}`, if nothing else uses it"),
        ),
        DpdkDevice::Other => ok("device", format!("{name}: whether DPDK has it shows when the daemon starts")),
    };
    Finding { interface: Some(port.interface.clone()), ..finding }
}

fn kernel(facts: &Facts) -> Vec<Finding> {
    let version = facts.kernel;
    let mut findings = vec![match version {
        old if old < FLOOR => failed(
            "kernel",
            format!("{old}, and XDP needs {FLOOR}"),
            "boot a newer kernel, or set `data_plane: userspace`",
        ),
        old if old < FRAGS => warning(
            "kernel",
            format!("{old}: no XDP above an MTU of about 3500"),
            "use a kernel from 5.18 on for larger MTUs",
        ),
        old if old < FEATURES => warning(
            "kernel",
            format!("{old}: it does not say which interfaces take redirected frames"),
            "use a kernel from 6.3 on, or see to it yourself that every veth has a peer with GRO on",
        ),
        new => ok("kernel", new.to_string()),
    }];
    findings.push(match &facts.missing_capabilities[..] {
        [] => ok("capabilities", "all that the daemon needs".into()),
        missing => failed(
            "capabilities",
            format!("this process lacks {}", missing.join(", ")),
            "run as root, or give the daemon these capabilities; check again with the same ones",
        ),
    });
    findings.push(match &facts.losses {
        Ok(()) => ok("btf", "the kernel describes its types: lost redirects can be counted".into()),
        Err(error) => warning(
            "btf",
            format!("frames lost after a redirect cannot be counted: {error}"),
            "use a kernel with CONFIG_DEBUG_INFO_BTF",
        ),
    });
    findings.extend(facts.bpffs.as_ref().map(|bpffs| match bpffs {
        Bpffs::Mounted { path } => ok("bpffs", format!("{path}, writable")),
        Bpffs::Missing { path, may_mount: false, .. } => warning(
            "bpffs",
            format!("none at {path}, and this process may not mount it: forwarding would end with the daemon"),
            format!("`mount -t bpf bpf {path}` as root"),
        ),
        Bpffs::Missing { path, private: true, .. } => warning(
            "bpffs",
            format!(
                "none at {path}, and what the daemon mounts in a mount namespace of its own ends with it, as \
                     does forwarding"
            ),
            "mount one outside (of `ip netns exec`, for example), and name it as `bpffs`",
        ),
        Bpffs::Missing { path, .. } => ok("bpffs", format!("not at {path} yet; the daemon mounts it")),
        Bpffs::ReadOnly { path, reason } => warning(
            "bpffs",
            format!("{path} cannot be written ({reason}): forwarding would end with the daemon"),
            "run as its owner, or name another folder as `bpffs`",
        ),
        Bpffs::Occupied { path } => warning(
            "bpffs",
            format!("{path} holds something else: forwarding would end with the daemon"),
            "name an empty folder as `bpffs`, or `null` to do without",
        ),
    }));
    findings.extend(match &facts.object {
        Ok(Loaded { object, names, jitted }) => vec![
            ok("ebpf object", format!("{object}: loaded for {names} names and verified; taken out again")),
            match jitted {
                Some(true) => ok("jit", "the kernel has compiled the programs".into()),
                Some(false) => warning(
                    "jit",
                    "the kernel interprets the programs, which is several times slower".into(),
                    "`sysctl net.core.bpf_jit_enable=1`",
                ),
                None => warning(
                    "jit",
                    "the kernel does not say whether it has compiled the programs".into(),
                    "`sysctl net.core.bpf_jit_enable` should be 1",
                ),
            },
        ],
        // The error text names its remedy.
        Err(error) => vec![Finding { remedy: None, ..failed("ebpf object", error.clone(), "") }],
    });
    findings
}

fn one_interface(interface: &Interface, facts: &Facts, any_native: bool) -> Vec<Finding> {
    let device = &interface.device;
    let mut findings = vec![match (device.ethernet, device.up, device.running) {
        (false, ..) => {
            failed("state", "not an Ethernet interface".into(), "take it out of `interfaces`; use UDP over it")
        }
        (_, false, _) => failed("state", "down".into(), format!("`ip link set dev {} up`", device.name)),
        (.., false) => warning("state", "up, without a carrier".into(), "plug it in, or bring its other end up"),
        _ => ok("state", "up".into()),
    }];
    findings.push(match device.mtu {
        small if small < SMALLEST_MTU => failed(
            "mtu",
            format!("{small}, and QUIC needs {SMALLEST_MTU}"),
            format!("`ip link set dev {} mtu {SMALLEST_MTU}` or more", device.name),
        ),
        mtu => ok("mtu", mtu.to_string()),
    });
    if matches!(facts.wanted, Wanted::Xdp) && device.ethernet {
        findings.extend(xdp(interface, facts, any_native));
    }
    for finding in &mut findings {
        finding.interface = Some(device.name.clone());
    }
    findings
}

fn xdp(interface: &Interface, facts: &Facts, any_native: bool) -> Vec<Finding> {
    let (device, features) = (&interface.device, interface.features);
    let name = &device.name;
    let native = features.is_none_or(|features| features.native());
    let mut findings = vec![match (&device.program, interface.owner) {
        (None, _) => ok("program", "no XDP program is attached".into()),
        (Some(program), Owner::Switch) => ok("program", format!("{program}: a GDP switch's")),
        (Some(program), Owner::Foreign) => {
            failed("program", format!("another XDP program is attached: {program}"), program.remedy())
        }
    }];
    findings.push(if let Some(reason) = &interface.disturbed {
        let command = format!("`gdp-ctl serve --interface {name}` attaches XDP all the same");
        warning(
            "mode",
            format!(
                "{reason}, so the daemon leaves it alone; links over UDP are forwarded in \
                 userspace"
            ),
            command,
        )
    } else if native {
        let room = if device.kind == "veth" { 256 } else { 192 };
        ok("mode", format!("native XDP; drivers leave {room} bytes before a frame, at most {ENCAPSULATION} are needed"))
    } else {
        warning(
            "mode",
            format!(
                "the driver has no native XDP: generic is next, several times slower; the kernel makes 256 bytes \
                     of room before a frame, {ENCAPSULATION} are needed"
            ),
            "use an interface whose driver has XDP, if speed matters",
        )
    });
    if native && device.mtu > ONE_BUFFER {
        let several = facts.kernel >= FRAGS && features.is_none_or(|features| features.several_buffers());
        findings.push(if several {
            ok(
                "buffers",
                format!("an MTU of {} takes several buffers, and the driver hands XDP all of them", device.mtu),
            )
        } else {
            warning(
                "buffers",
                format!(
                    "an MTU of {} takes several buffers, which native XDP does not get here: generic is next",
                    device.mtu
                ),
                format!("`ip link set dev {name} mtu {ONE_BUFFER}` or less"),
            )
        });
    }
    findings.extend(features.filter(|_| any_native).map(|features| {
        match (features.takes_redirects(), &*device.kind) {
        (true, _) => ok("redirects", "takes frames that others redirect to it".into()),
        (_, "veth") => warning(
            "redirects",
            "takes no redirected frames, because its peer neither has GRO on nor runs an XDP program: frames leave \
             through the daemon".into(),
            "`ethtool -K PEER gro on`, for its peer, where that one is",
        ),
        _ => warning("redirects", "takes no redirected frames: frames leave through the daemon".into(), "use an \
                      interface whose driver has ndo_xdp_xmit"),
    }
    }));
    findings.extend(offloads(interface));
    findings
}

fn offloads(interface: &Interface) -> Vec<Finding> {
    let (device, on) = (&interface.device, interface.offloads);
    let off = |feature: &str| format!("`ethtool -K {} {feature} off`", device.name);
    let mut findings = Vec::new();
    if on.lro == Some(true) {
        findings.push(warning(
            "offloads",
            "LRO merges frames before XDP sees them, or keeps XDP off".into(),
            off("lro"),
        ));
    }
    if device.kind == "veth" && on.tx_checksum == Some(true) {
        let fact = "tx-checksum is on: what sockets here send leaves with unfinished checksums, and XDP at the other \
                    end forwards them so";
        findings.push(warning("offloads", fact.into(), off("tx")));
    }
    if interface.has_vlans && on.rx_vlan == Some(true) {
        let fact = "rx-vlan takes the tag off before XDP sees the frame, so VLAN links here are not the kernel's";
        findings.push(warning("offloads", fact.into(), off("rxvlan")));
    }
    if findings.is_empty() {
        findings.push(ok("offloads", "none that is in the way".into()));
    }
    findings
}

fn udp(udp: &UdpFacts) -> Vec<Finding> {
    let address = udp.address;
    vec![
        match &udp.state {
            PortState::Free => ok("udp port", format!("{address} is free")),
            PortState::Daemon => ok("udp port", format!("{address} is the running daemon's")),
            PortState::Taken(holder) => failed(
                "udp port",
                format!("{} has {address}", holder.as_deref().unwrap_or("another program")),
                "end it, or choose another port as `udp`",
            ),
            PortState::Refused(error) => failed(
                "udp port",
                format!("{address} cannot be had: {error}"),
                "choose an address of this host as `udp`",
            ),
        },
        match &udp.zero_checksum_v6 {
            Ok(()) => ok("udp over ipv6", "a socket takes datagrams without a checksum".into()),
            Err(error) => warning(
                "udp over ipv6",
                format!("no datagrams without a checksum: {error}"),
                "turn IPv6 on if links over it are wanted; over IPv4 nothing is to be done",
            ),
        },
    ]
}

fn left_over(left: &LeftOver) -> Finding {
    let folder = &left.folder;
    match (left.daemon, left.abi == ABI, left.here) {
        (true, ..) => ok("pins", format!("a daemon runs with {folder}")),
        (_, false, true) => failed(
            "pins",
            format!("what a daemon of another version left at {folder} still forwards"),
            "`gdp-ctl xdp detach` removes it, and frames stop until a daemon runs again",
        ),
        (.., here) => warning(
            "pins",
            format!(
                "what a daemon that is no more left at {folder} still forwards{}",
                if here { "" } else { ", in another network namespace or one that is gone" }
            ),
            "`gdp-ctl serve` with the same key takes it over, `gdp-ctl xdp detach` removes it",
        ),
    }
}

fn clock(clock: &Clock) -> Finding {
    match clock.unix {
        wrong if !SANE.contains(&wrong) => failed(
            "clock",
            format!("{wrong} s since 1970: certificates are judged by the time"),
            "set it: `timedatectl set-ntp true`, or `date -s`",
        ),
        _ if !clock.synchronised => warning(
            "clock",
            "nothing keeps it right; certificates are judged by the time".into(),
            "run an NTP client such as chrony or systemd-timesyncd",
        ),
        _ => ok("clock", "set, and kept right".into()),
    }
}

fn ok(check: &'static str, fact: String) -> Finding {
    Finding { check, interface: None, level: Level::Ok, fact, remedy: None }
}

fn warning(check: &'static str, fact: String, remedy: impl Into<String>) -> Finding {
    Finding { level: Level::Warning, remedy: Some(remedy.into()), ..ok(check, fact) }
}

fn failed(check: &'static str, fact: String, remedy: impl Into<String>) -> Finding {
    Finding { level: Level::Failed, remedy: Some(remedy.into()), ..ok(check, fact) }
}

#[cfg(test)]
#[path = "../../tests/unit/doctor.rs"]
mod tests;
