//! The data planes of a daemon behind one owner. The userspace plane always runs and holds the full
//! tables; where XDP attaches, the kernel holds the same entries and forwards before the daemon
//! sees a frame. Instead of XDP, DPDK may be before it.
//!
//! Knows links and routes as `gdp-wire` has them, nothing of names' owners, certificates or the
//! RIB. Called by the daemon (`serve`); [`kernel`] and [`fib`] also by the kernel tests and `bench
//! forward`.
//!
//! - [`kernel`]: the BPF maps and programs; [`object`], [`kernel_version`] and [`kernel_errors`]
//!   serve it
//! - [`dpdk`]: devices that this process drives by itself, and the loops between them
//! - [`losses`]: what is lost after a redirect; [`kernel_types`] serves it
//! - [`capabilities`]: which this needs of Linux's
//! - [`disturbance`]: on which interfaces XDP is in somebody's way
//! - [`device`]: interfaces as the kernel describes them; [`xdp_features`] and [`netlink`] serve it
//! - [`tables`]: the full tables, which threads read while they change
//! - [`userspace`]: what happens to one frame, pure; [`forwarder`]: the threads and sockets around
//!   it
//! - [`fib`]: the names in the kernel; [`resizable_table`]: room for more of them, there and in the
//!   full tables
//! - [`groups`]: which links take copies of a frame; [`kernel_groups`] and [`group_slots`]: what
//!   the kernel holds of them
//! - [`link_memory`]: what the two planes share; this and the FIB are [`mapping`]s
//! - [`queues`]: where frames wait to be sent
//! - [`notices`]: what neighbours say to this node itself
//! - [`host_pair`]: the interfaces between the switch and endpoints on its own host
//! - [`udp`]: which addresses and interfaces carry links over UDP
//! - [`tally`]: what is counted by link and by name
//! - [`pins`]: what stays in the kernel when the daemon dies
// They panic where stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod attach_mode;
pub mod capabilities;
pub mod device;
pub mod disturbance;
pub mod dpdk;
pub mod fib;
pub mod forwarder;
mod forwarder_state;
pub mod group_slots;
pub mod groups;
pub mod host_pair;
mod interface_plane;
pub mod kernel;
pub mod kernel_errors;
pub mod kernel_failures;
pub mod kernel_groups;
pub mod kernel_types;
pub mod kernel_version;
pub mod link_memory;
pub mod losses;
mod map_update;
mod mapping;
pub mod netlink;
pub mod notices;
pub mod object;
pub mod pins;
pub mod queues;
mod resizable_table;
pub mod tables;
pub mod tally;
pub mod udp;
pub mod userspace;
mod verified;
pub mod xdp_features;

use crate::tables::permits::without;
use std::collections::{HashMap, HashSet};
use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use gdp_core::name::NamePrefix;
use gdp_link::link::KeyedEntry;
use gdp_link::port::{DataSocket, HostPair, Interface, LinkAddr};
use gdp_wire::table::{ANY_WRITER, EGRESS_SET_SIZE, NEIGHBOURS, PORT_ROUTED, PORT_USERSPACE, ip_of, mac_bytes};
use gdp_wire::{
    Carrier, Counter, FibEntry, Header, LinkEntry, LinkRole, LocalAddress, Name, Permit, SwitchConfig, Vlan,
};

use crate::attach_mode::Mode;
use crate::forwarder_state::{Medium, Shared};
use crate::kernel_failures::{LoadError, UpdateError};
use device::Device;
use dpdk::{DeviceCounters, DpdkConfig, DpdkPlane, DpdkPlaneError};
use forwarder::Forwarder;
use group_slots::Member;
use groups::Groups;
pub use interface_plane::{InterfacePlane, SUPPORTED};
use kernel::{Adopted, KernelPlane};
use link_memory::LinkMemory;
use notices::Notices;
use pins::{Pins, PinsError};
use tables::UserTables;
use udp::Routing;
use xdp_features::XdpFeatures;

/// Names the FIB can hold unless configured otherwise. The kernel's table begins with room for 1024
/// names and doubles as names come: 128 to 256 B of kernel memory each.
pub const FIB_CAPACITY: u32 = 65536;

/// Largest frame read from UDP.
const LARGEST_UDP_FRAME: usize = 2048;

/// Which data plane the operator wants.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wanted {
    /// Native XDP, else generic XDP, else userspace; the report says which and why.
    #[default]
    Auto,
    /// XDP, or an error.
    Xdp,
    /// DPDK, or an error.
    Dpdk,
    /// Neither XDP nor DPDK.
    Userspace,
}

/// How the planes are set up.
#[derive(Clone, Debug)]
pub struct PlaneConfig {
    pub wanted: Wanted,
    /// The eBPF object, if not the one that [`object::Object::find`] finds.
    pub ebpf_object: Option<PathBuf>,
    /// For the DPDK plane.
    pub dpdk: DpdkConfig,
    /// The file in which DPDK's settings of interfaces outlive a daemon that is killed, if they are
    /// to.
    pub dpdk_settings: Option<PathBuf>,
    /// Names the FIB can hold.
    pub fib_capacity: u32,
    /// Of GDP frames.
    pub ethertype: u16,
    /// Where the kernel keeps what is to outlive the daemon, if anything is.
    pub pins: Option<PinLocation>,
    /// Whether to count the frames that are lost after a redirect. What counts them sees each batch
    /// of redirected frames of the whole machine, so one switch of a machine should.
    pub count_losses: bool,
}

/// A place for the pins of a switch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PinLocation {
    pub bpffs: PathBuf,
    pub switch: Name,
}

impl Default for PlaneConfig {
    fn default() -> Self {
        let ethertype = gdp_wire::ETHERTYPE;
        let wanted = Wanted::Auto;
        let dpdk = DpdkConfig::default();
        Self {
            wanted,
            ebpf_object: None,
            dpdk,
            dpdk_settings: None,
            fib_capacity: FIB_CAPACITY,
            ethertype,
            pins: None,
            count_losses: true,
        }
    }
}

#[derive(Debug, thiserror::Error)]
pub enum PlaneError {
    #[error("{interface}: `data_plane: xdp` was asked for, but {reason}")]
    NoXdp { interface: String, reason: String },
    #[error("`data_plane: xdp` was asked for: {0}")]
    Load(#[from] LoadError),
    #[error("`data_plane: dpdk` was asked for: {0}")]
    Dpdk(#[from] DpdkPlaneError),
    #[error(transparent)]
    Pins(#[from] PinsError),
    #[error(transparent)]
    Update(#[from] UpdateError),
    #[error("{interface}: cannot start a thread: {source}")]
    Thread { interface: String, source: std::io::Error },
}

/// Where a name leads from this switch, in links.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PlaneRoute {
    /// Egress switches that want a copy, this one's own bit included if there are readers here.
    pub egress_bits: u64,
    /// Links of the local readers, sorted, without duplicates.
    pub readers: Vec<u32>,
    /// Links of the local endpoints, and into other domains, on which frames to the name may come,
    /// sorted, without duplicates; or [`ANY_WRITER`] alone.
    pub writers: Vec<u32>,
    /// Links into other domains on which frames from the name may come, sorted, without duplicates.
    pub sources: Vec<u32>,
}

impl PlaneRoute {
    /// Whether frames to the name go nowhere, and none from it come from abroad: then the data
    /// plane need not hold it.
    pub fn is_idle(&self) -> bool {
        self.egress_bits == 0 && self.readers.is_empty() && self.sources.is_empty()
    }
}

/// All planes of a daemon. Dropping it detaches the XDP programs and ends the threads; but what was
/// taken over from an earlier daemon stays in the kernel as long as that has not been brought to an
/// end.
///
/// Whatever changes it is to be called in the network namespace of its interfaces: the kernel knows
/// them by number.
pub struct Planes {
    config: PlaneConfig,
    kernel: Result<KernelPlane, String>,
    /// Instead of the kernel's.
    dpdk: Option<DpdkPlane>,
    features: Option<XdpFeatures>,
    tables: UserTables,
    shared: Arc<Shared>,
    link_memory: LinkMemory,
    own_bit: u64,
    groups: Groups,
    /// Ethernet ports by interface.
    ports: HashMap<u32, Port>,
    /// Interfaces that have a program, or should: those of Ethernet ports, or below them, and those
    /// that carry UDP.
    devices: HashMap<u32, Served>,
    udp: Option<UdpPort>,
    /// The switch's end of the pair, of this daemon or the one before; 0 if there is none.
    host_pair: u32,
    /// Once links over UDP are used.
    routing: Option<Routing>,
    /// By which interface links over UDP leave that the kernel can copy frames to.
    routes_of_links: HashMap<u32, u32>,
    left: Option<Left>,
}

/// What an earlier daemon left in the kernel, and nobody has confirmed or removed yet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Left {
    /// This switch's egress bit.
    pub own_bit: u64,
    /// With where frames of each go.
    pub links: Vec<(KeyedEntry, LinkAddr)>,
    pub routes: Vec<(Name, PlaneRoute)>,
    pub next_hops: [u32; EGRESS_SET_SIZE as usize],
    /// Interfaces.
    pub ports: HashSet<u32>,
}

/// An interface that GDP runs on directly.
struct Port {
    interface: String,
    /// The interface that takes its frames: itself, or the one that it is a VLAN of.
    device: u32,
    vlan: Option<u16>,
    forwarder: Forwarder,
}

/// Where the links over UDP are.
struct UdpPort {
    bound: SocketAddr,
    forwarder: Forwarder,
    /// For endpoints on this host.
    pair: Option<host_pair::Ends>,
    /// Interfaces that have one of the socket's addresses, and the switch's end of the pair.
    devices: HashSet<u32>,
    /// Interfaces that come from now on are logged.
    logs: bool,
}

/// An interface that packets arrive on and leave by.
struct Served {
    name: String,
    attached: Option<Mode>,
    /// Why it got this plane.
    reason: String,
    /// See [`InterfacePlane::left_alone`].
    left_alone: bool,
    /// Whether the kernel sends there; its key in the device map is the index of the interface.
    sends: bool,
}

impl Planes {
    /// Loads what can be loaded. Fails only if XDP was explicitly wanted.
    pub fn open(config: PlaneConfig) -> Result<Self, PlaneError> {
        let mut kernel = match config.wanted {
            Wanted::Userspace => Err("`--no-xdp` or `data_plane: userspace` turns it off".to_owned()),
            Wanted::Dpdk => Err("`data_plane: dpdk` was asked for, and this is none of its ports".to_owned()),
            Wanted::Xdp => Ok(load(&config)?),
            Wanted::Auto => match load(&config) {
                // Something forwards, and it is not for this daemon to end it.
                Err(LoadError::Pins(error)) => return Err(error.into()),
                loaded => loaded.map_err(|error| error.to_string()),
            },
        };
        match &mut kernel {
            Ok(kernel) if !config.count_losses => kernel.forgo_losses(),
            Ok(_) => {}
            Err(_) => clear_left_over(&config)?,
        }
        let adopted = kernel.as_ref().map_or(Ok(None), KernelPlane::adopted)?;
        let link_memory = kernel.as_ref().map_or_else(|_| LinkMemory::new(), |kernel| kernel.link_memory().clone());
        let tables = UserTables::new(link_memory.clone(), config.fib_capacity)?;
        let shared = Arc::new(Shared::new(tables.queues().clone()));
        let dpdk = match config.wanted {
            Wanted::Dpdk => {
                let kept = config.dpdk_settings.clone();
                Some(DpdkPlane::start(&config.dpdk, kept, config.ethertype, || tables.reader(), &shared)?)
            }
            _ => {
                if let Some(kept) = &config.dpdk_settings {
                    DpdkPlane::put_back_left(kept);
                }
                None
            }
        };
        let mut planes = Self {
            config,
            kernel,
            dpdk,
            // Kernels before 6.3 cannot be asked; there it is assumed that native XDP comes with
            // redirection.
            features: XdpFeatures::open().ok(),
            shared,
            tables,
            link_memory,
            own_bit: 0,
            groups: Groups::default(),
            ports: HashMap::new(),
            devices: HashMap::new(),
            udp: None,
            host_pair: 0,
            routing: None,
            routes_of_links: HashMap::new(),
            left: None,
        };
        match adopted {
            Some(adopted) => planes.adopt(adopted)?,
            None => planes.set_own_bit(0)?,
        }
        planes.set_kernel_group(NEIGHBOURS);
        Ok(planes)
    }

    /// What an earlier daemon left and this one has taken over: it is in the tables, and stays
    /// until it is replaced, removed, or [`Self::end_adoption`].
    pub fn left(&self) -> Option<&Left> {
        self.left.as_ref()
    }

    /// From now on nothing is here because an earlier daemon left it, but for links and routes:
    /// those are the caller's.
    pub fn end_adoption(&mut self) -> Result<(), PlaneError> {
        let Some(left) = self.left.take() else { return Ok(()) };
        if let Ok(kernel) = &mut self.kernel {
            for ifindex in left.ports.iter().filter(|ifindex| !self.devices.contains_key(ifindex)) {
                kernel.clear_port(*ifindex)?;
            }
            if let Err(error) = kernel.drop_left_over() {
                tracing::warn!(%error, "a program of an earlier daemon stays on an interface");
            }
        }
        self.refresh()?;
        self.set_all_kernel_groups();
        Ok(())
    }

    /// Takes over what arrives on an interface (of the calling thread's network namespace) by the
    /// best plane there is. What is a VLAN is served on the interface below it: native XDP runs
    /// only there.
    pub fn attach(&mut self, interface: &Interface, socket: Arc<DataSocket>) -> Result<InterfacePlane, PlaneError> {
        self.detach(interface.index);
        let (device, name) = match &interface.vlan {
            Some(vlan) => (vlan.lower_index, &vlan.lower),
            None => (interface.index, &interface.name),
        };
        self.use_device(device, name, true);
        if self.devices[&device].attached.is_none() && self.config.wanted == Wanted::Xdp {
            let reason = self.devices[&device].reason.clone();
            self.leave_device(device);
            return Err(PlaneError::NoXdp { interface: interface.name.clone(), reason });
        }
        let medium = Medium::Ethernet(interface.index);
        let forwarder = Forwarder::start(medium, socket, interface.mtu as usize, &self.shared, self.tables.reader())
            .map_err(|source| PlaneError::Thread { interface: interface.name.clone(), source })?;
        let vlan = interface.vlan.as_ref().map(|vlan| vlan.id);
        let port = Port { interface: interface.name.clone(), device, vlan, forwarder };
        self.ports.insert(interface.index, port);
        self.refresh()?;
        self.set_all_kernel_groups();
        Ok(self.report_of(&interface.name, device))
    }

    /// Lets go of an interface; what arrives there is no longer forwarded. An unknown one is no
    /// error.
    pub fn detach(&mut self, ifindex: u32) {
        let Some(port) = self.ports.remove(&ifindex) else { return };
        self.leave_device(port.device);
        self.set_all_kernel_groups();
    }

    /// Lets go of everything; nothing stays in the kernel.
    pub fn detach_all(&mut self) {
        self.stop_threads();
        for port in std::mem::take(&mut self.ports).into_values() {
            self.leave_device(port.device);
        }
        self.detach_udp();
        self.dpdk = None;
        self.left = None;
        if let Ok(kernel) = &mut self.kernel
            && let Err(error) = kernel.unpin()
        {
            tracing::warn!(%error, "something stays in the kernel; `gdp-ctl xdp detach` removes it");
        }
    }

    /// Whether the kernel forwards on when this process dies.
    pub fn outlives(&self) -> bool {
        self.kernel.as_ref().is_ok_and(KernelPlane::is_pinned)
    }

    /// So that the threads end side by side.
    fn stop_threads(&self) {
        let udp = self.udp.iter().map(|udp| &udp.forwarder);
        self.ports.values().map(|port| &port.forwarder).chain(udp).for_each(Forwarder::stop);
    }

    /// Takes over what arrives over UDP at `bound`: in the kernel on the Ethernet interfaces that
    /// have such an address and can run native XDP without a [`disturbance`] (generic XDP would
    /// burden all that the host receives there), otherwise in userspace. `pair`: by which endpoints
    /// on this host are to send.
    pub fn attach_udp(
        &mut self,
        socket: Arc<DataSocket>,
        bound: SocketAddr,
        pair: Option<host_pair::Ends>,
    ) -> Result<Vec<InterfacePlane>, PlaneError> {
        self.detach_udp();
        let forwarder = Forwarder::start(Medium::Udp, socket, LARGEST_UDP_FRAME, &self.shared, self.tables.reader())
            .map_err(|source| PlaneError::Thread { interface: "udp".into(), source })?;
        self.host_pair = pair.as_ref().map_or(0, |pair| pair.switch.index);
        self.udp = Some(UdpPort { bound, forwarder, pair, devices: HashSet::new(), logs: false });
        self.set_own_bit(self.own_bit)?;
        self.refresh()?;
        self.udp.iter_mut().for_each(|udp| udp.logs = true);
        let devices = self.udp.iter().flat_map(|udp| &udp.devices);
        Ok(devices.map(|device| self.report_of(&self.devices[device].name, *device)).collect())
    }

    /// Whether there are XDP programs, or why not.
    pub fn xdp(&self) -> Result<(), String> {
        self.kernel.as_ref().map(drop).map_err(String::clone)
    }

    /// Whether endpoints on this host can get past the daemon, if there is a kernel plane and
    /// `bound` is where they dial in.
    pub fn takes_pair(&self, bound: SocketAddr) -> Result<(), String> {
        self.xdp()?;
        // What the kernel plane leaves to the daemon comes to the host's address on the pair.
        let any = bound.ip().is_unspecified();
        any.then_some(()).ok_or_else(|| format!("the UDP address is {bound}, and not 0.0.0.0 or [::]"))
    }

    /// The pair by which endpoints on this host reach the kernel plane, and it them; if that works
    /// now.
    pub fn host_pair(&self) -> Option<HostPair> {
        let pair = self.udp.as_ref()?.pair.as_ref()?;
        let works =
            self.devices.get(&pair.switch.index).is_some_and(|device| device.attached.is_some() && device.sends);
        works.then_some(pair.addresses)
    }

    fn detach_udp(&mut self) {
        let Some(udp) = self.udp.take() else { return };
        udp.devices.into_iter().for_each(|device| self.leave_device(device));
    }

    /// Which plane each interface got and why, by interface name.
    pub fn report(&self) -> Vec<InterfacePlane> {
        let mut report: Vec<_> = self.ports.values().map(|port| self.report_of(&port.interface, port.device)).collect();
        let udp =
            self.udp.iter().flat_map(|udp| &udp.devices).filter_map(|device| Some((device, self.devices.get(device)?)));
        let others = udp.filter(|(_, device)| self.ports.values().all(|port| port.interface != device.name));
        report.extend(others.map(|(ifindex, device)| self.report_of(&device.name, *ifindex)));
        report.sort_by(|a, b| a.interface.cmp(&b.interface));
        report
    }

    /// Why links over UDP, of IPv4 and of IPv6, are left to the userspace plane, if they are.
    pub fn udp_in_userspace(&self) -> [Option<String>; 2] {
        if self.dpdk.is_some() {
            return [None, None];
        }
        match (&self.kernel, &self.routing) {
            (Err(reason), _) => [Some(reason.clone()), Some(reason.clone())],
            (_, Some(routing)) => [routing.v4.clone().err(), routing.v6.clone().err()],
            (Ok(_), None) => [None, None],
        }
    }

    /// Adds or replaces a link; frames of it are sent to `to`. `entry.port` is filled in here.
    pub fn set_link(&mut self, mut entry: LinkEntry, to: LinkAddr) -> Result<(), PlaneError> {
        if let Some(dpdk) = &mut self.dpdk {
            dpdk.follow_link(&entry);
        }
        entry.port = self.port_for(&entry, to);
        if self.tables.link(entry.id).is_none() {
            self.link_memory.begin(entry.id);
            self.shared.notices.begin(entry.id);
            self.shared.tally.begin(entry.id);
            if let Ok(kernel) = &mut self.kernel {
                kernel.begin_link(entry.id)?;
            }
        }
        let before = self.tables.set_link(entry, to);
        if let Ok(kernel) = &mut self.kernel {
            kernel.set_link(&entry)?;
        }
        let is_rerouted = self.follow_route(&entry);
        let place = |link: &LinkEntry| (link.id, link.role, link.port, link.reach);
        if is_rerouted || before.as_ref().map(|before| place(before)) != Some(place(&entry)) {
            self.set_kernel_groups_of(before.as_slice());
            self.set_kernel_groups_of(&[entry.into()]);
        }
        Ok(())
    }

    /// Frames sent on a link by any plane.
    pub fn frames_sent(&self, id: u32) -> u64 {
        self.link_memory.sent(id)
    }

    /// Asks the data plane of the neighbour on a link whether it lives.
    pub fn ask(&self, link: u32, cookie: u64) {
        self.send_own(link, Header::echo(cookie), &[]);
    }

    /// Sends a probe (see [`Header::probe`]) to the neighbour on a link.
    pub fn probe(&self, link: u32, probe: Header, cookie: u64) {
        self.send_own(link, probe, &cookie.to_be_bytes());
    }

    fn send_own(&self, link: u32, header: Header, payload: &[u8]) {
        if let Some((header, to)) = self.tables.address_frame(link, header) {
            self.shared.send_own(to, header, payload);
        }
    }

    /// What neighbours said to this node itself.
    pub fn notices(&self) -> &Arc<Notices> {
        &self.shared.notices
    }

    /// An unknown link is no error.
    pub fn remove_link(&mut self, id: u32) -> Result<(), PlaneError> {
        let Some(removed) = self.tables.remove_link(id) else { return Ok(()) };
        self.routes_of_links.remove(&id);
        self.set_kernel_groups_of(&[removed]);
        if let Ok(kernel) = &mut self.kernel {
            kernel.remove_link(id)?;
        }
        Ok(())
    }

    /// All links, as the planes hold them.
    pub fn links(&self) -> Vec<KeyedEntry> {
        self.tables.links().map(|(entry, _)| entry.clone()).collect()
    }

    /// Adds or replaces where a name leads. If the FIB is full, nothing is changed; all planes hold
    /// the same number.
    pub fn set_route(&mut self, name: Name, route: &PlaneRoute) -> Result<(), PlaneError> {
        self.set_route_by_group(name, route, None)
    }

    /// `number`: the one that the group of the readers had, if it is new here.
    fn set_route_by_group(&mut self, name: Name, route: &PlaneRoute, number: Option<u32>) -> Result<(), PlaneError> {
        if !self.tables.has_room_for(&name) {
            return Err(UpdateError::FibFull { capacity: self.config.fib_capacity }.into());
        }
        let (group, is_new) = self.groups.take_as(&route.readers, number);
        if is_new {
            self.tables.set_group(group, &route.readers);
        }
        let beyond = (route.egress_bits & !self.own_bit).count_ones() as usize;
        let forks = beyond + route.readers.len() > 1 && self.groups.fork(group);
        if is_new || forks {
            self.set_kernel_group(group);
        }
        let (entry, permits) = entry_of(&name, route, group);
        let before = match self.tables.set_route(name, entry, &permits) {
            Ok(before) => before,
            Err(error) => {
                self.release_group(group);
                return Err(error.into());
            }
        };
        let set = self.set_kernel_route(&name, entry, &permits, before.as_ref().map_or(&[], |(_, permits)| permits));
        let released = match (&set, before) {
            (Ok(()), before) => before.map(|(before, _)| before.group),
            (Err(_), Some((before, permits))) => {
                // What it held until now it has room for.
                let _ = self.tables.set_route(name, before, &permits);
                Some(group)
            }
            (Err(_), None) => {
                self.tables.remove_route(&name);
                Some(group)
            }
        };
        released.into_iter().for_each(|group| self.release_group(group));
        Ok(set?)
    }

    /// An unknown name is no error.
    pub fn remove_route(&mut self, name: &Name) -> Result<(), PlaneError> {
        if let Ok(kernel) = &mut self.kernel {
            kernel.remove_route(name);
        }
        let Some((before, permits)) = self.tables.remove_route(name) else { return Ok(()) };
        if let Ok(kernel) = &mut self.kernel {
            permits.iter().try_for_each(|permit| kernel.forbid(permit))?;
        }
        self.release_group(before.group);
        Ok(())
    }

    /// Where a name leads, as the planes were told.
    pub fn route(&self, name: &Name) -> Option<FibEntry> {
        self.tables.route(name)
    }

    /// Of the names that lead somewhere, those that begin so; `limit` of them at most.
    pub fn names_like(&self, prefix: &NamePrefix, limit: usize) -> Vec<Name> {
        let names = self.tables.routes().map(|(name, _)| name).filter(|name| prefix.matches(name));
        names.take(limit).collect()
    }

    /// For each egress bit the link toward that switch; 0 if there is none.
    pub fn next_hop(&self, bit: u8) -> u32 {
        self.tables.next_hop(bit.into())
    }

    /// The links that may send to a name.
    pub fn writers(&self, name: &Name) -> Vec<u32> {
        let tables = &self.tables;
        let first = tables.route(name).map(|entry| entry.writer_link).filter(|link| ![0, ANY_WRITER].contains(link));
        let others = tables.permits(name).iter().filter(|permit| permit.part == Permit::DESTINATION);
        first.into_iter().chain(others.map(|permit| permit.link)).collect()
    }

    /// The links of the local readers of a name.
    pub fn readers(&self, entry: &FibEntry) -> Vec<u32> {
        self.groups.readers(entry.group).to_vec()
    }

    /// The plane before the userspace plane: `kernel`, also where none attached, or `dpdk`.
    pub fn first_plane(&self) -> &'static str {
        if self.dpdk.is_some() { "dpdk" } else { "kernel" }
    }

    /// Whether frames that leave by a link do so without the userspace plane, if they come in by
    /// the plane before it.
    pub fn first_plane_sends_on(&self, id: u32) -> bool {
        (self.kernel.is_ok() || self.dpdk.is_some())
            && self.tables.link(id).is_some_and(|link| link.port != PORT_USERSPACE)
    }

    /// For each egress bit the link toward that switch, or 0.
    pub fn set_next_hops(&mut self, next_hops: &[u32; EGRESS_SET_SIZE as usize]) -> Result<(), PlaneError> {
        self.tables.set_next_hops(next_hops);
        if let Ok(kernel) = &mut self.kernel {
            kernel.set_next_hops(next_hops)?;
        }
        Ok(())
    }

    /// This switch's own egress bit; 0 before it has one.
    pub fn set_own_bit(&mut self, own_bit: u64) -> Result<(), PlaneError> {
        self.own_bit = own_bit;
        self.tables.set_own_bit(own_bit);
        let config = SwitchConfig { own_bit, ethertype: self.config.ethertype.into(), host_pair: self.host_pair };
        if let Ok(kernel) = &mut self.kernel {
            kernel.set_config(config)?;
        }
        self.set_all_kernel_groups();
        Ok(())
    }

    /// What the devices of the DPDK plane have counted, by the name of the interface on the host's
    /// side.
    pub fn dpdk_devices(&self) -> HashMap<String, DeviceCounters> {
        self.dpdk.as_ref().map_or_else(HashMap::new, DpdkPlane::devices)
    }

    /// Processor time that each loop of the DPDK plane has taken; none without it.
    pub fn dpdk_processor_time(&self) -> Vec<Duration> {
        self.dpdk.as_ref().map_or_else(Vec::new, DpdkPlane::processor_time)
    }

    /// Each counter with what [`Self::first_plane`] and what the userspace plane counted.
    pub fn counters(&self) -> Result<Vec<(Counter, u64, u64)>, PlaneError> {
        let kernel = match &self.dpdk {
            Some(dpdk) => dpdk.counters(),
            None => self.kernel.as_ref().map_or(Ok([0; Counter::COUNT]), KernelPlane::counters)?,
        };
        let userspace = self.shared.counters();
        Ok(Counter::ALL.iter().zip(kernel.into_iter().zip(userspace)).map(|(c, (k, u))| (*c, k, u)).collect())
    }

    /// What became of the frames that came in on a link, whichever plane took them. In the order of
    /// [`Counter::ALL`].
    pub fn arrivals(&self, link: u32) -> Result<tally::Row, PlaneError> {
        let userspace = self.shared.tally.of(link);
        let Ok(kernel) = &self.kernel else { return Ok(userspace) };
        let kernel = kernel.tally().of(link).map_err(|source| UpdateError::Map { map: "LINK_COUNTERS", source })?;
        Ok(std::array::from_fn(|i| kernel[i] + userspace[i]))
    }

    /// The names most frames left for, the busiest first, with about how many those were.
    pub fn busiest(&self, limit: usize) -> Result<Vec<(Name, u64)>, PlaneError> {
        let mut names = self.shared.tally.busiest();
        if let Ok(kernel) = &self.kernel {
            let counted = kernel.tally().busiest().map_err(|source| UpdateError::Map { map: "BUSIEST", source })?;
            counted.into_iter().for_each(|(name, frames)| *names.entry(name).or_default() += frames);
        }
        let mut names: Vec<_> = names.into_iter().collect();
        names.sort_unstable_by_key(|(name, frames)| (std::cmp::Reverse(*frames), *name));
        names.truncate(limit);
        Ok(names)
    }

    /// Frames that were lost after a redirect, by the name of the interface they were to leave by;
    /// or why that is not known.
    pub fn losses(&self) -> Result<HashMap<String, u64>, String> {
        if let Some(dpdk) = &self.dpdk {
            return Ok(dpdk.losses());
        }
        let Ok(kernel) = &self.kernel else { return Ok(HashMap::new()) };
        if let Some(error) = kernel.uncounted() {
            return Err(format!("frames that are lost after a redirect are not counted: {error}"));
        }
        let losses = kernel.losses().map_err(|error| error.to_string())?;
        let named =
            losses.into_iter().filter_map(|(ifindex, lost)| Some((self.devices.get(&ifindex)?.name.clone(), lost)));
        Ok(named.collect())
    }

    /// What frames are forwarded by: read back from the kernel where XDP runs.
    pub fn routes(&self) -> Result<Vec<(Name, FibEntry)>, PlaneError> {
        Ok(self.routes_behind(None, usize::MAX)?.0)
    }

    /// Of [`Self::routes`] at most `limit` behind `after`, in the order of their digits; and
    /// whether there are more.
    pub fn routes_behind(
        &self,
        after: Option<Name>,
        limit: usize,
    ) -> Result<(Vec<(Name, FibEntry)>, bool), PlaneError> {
        let behind = |name: &Name| after.is_none_or(|after| name.as_bytes() > after.as_bytes());
        let mut routes: Vec<_> = self.tables.routes().filter(|(name, _)| behind(name)).collect();
        let order = |a: &(Name, FibEntry), b: &(Name, FibEntry)| a.0.as_bytes().cmp(b.0.as_bytes());
        let more = routes.len() > limit;
        if more {
            routes.select_nth_unstable_by(limit, order);
            routes.truncate(limit);
        }
        routes.sort_unstable_by(order);
        match &self.kernel {
            Ok(kernel) if self.devices.values().any(|device| device.attached.is_some()) => {
                let mut held = Vec::with_capacity(routes.len());
                for (name, _) in routes {
                    held.extend(kernel.route(&name).map(|entry| (name, entry)));
                }
                Ok((held, more))
            }
            _ => Ok((routes, more)),
        }
    }

    /// Looks again at which addresses UDP arrives, which interfaces take redirected frames (a veth
    /// does depending on its peer), and by which interfaces links over UDP leave; and moves links,
    /// and groups of them, to the plane that can send. Cheap; for the daemon to call now and then,
    /// and after changes to interfaces, in the network namespace of these.
    pub fn refresh(&mut self) -> Result<(), PlaneError> {
        self.follow_dpdk();
        self.follow_udp()?;
        self.follow_vlans()?;
        let sends: HashMap<u32, bool> =
            self.devices.keys().map(|ifindex| (*ifindex, self.kernel_can_send_to(*ifindex))).collect();
        for (ifindex, sends) in &sends {
            if *sends && !self.devices[ifindex].sends {
                self.make_port(*ifindex)?;
            }
        }
        let stop: Vec<u32> = sends
            .into_iter()
            .filter(|(ifindex, sends)| !sends && self.devices[ifindex].sends)
            .map(|(i, _)| i)
            .collect();
        for ifindex in &stop {
            self.devices.get_mut(ifindex).into_iter().for_each(|device| device.sends = false);
        }
        let links: Vec<_> = self.tables.links().cloned().collect();
        for (entry, to) in links {
            if self.port_for(&entry, to) != entry.port {
                self.set_link(*entry, to)?;
            }
        }
        self.follow_routes();
        // Last: no link leads there any more.
        if let Ok(kernel) = &mut self.kernel {
            stop.into_iter().try_for_each(|ifindex| kernel.clear_port(ifindex))?;
        }
        Ok(())
    }

    /// Tells the DPDK plane what it cannot see by itself.
    fn follow_dpdk(&mut self) {
        let Some(dpdk) = &mut self.dpdk else { return };
        let vlans: Vec<_> = self.ports.values().filter_map(|port| Some((port.device, port.vlan?))).collect();
        dpdk.follow(self.udp.as_ref().map(|udp| udp.bound), &vlans, self.tables.links().map(|(entry, _)| entry));
    }

    /// Has the kernel take what arrives at the addresses that the UDP socket has now, on the
    /// interfaces that have them.
    fn follow_udp(&mut self) -> Result<(), PlaneError> {
        let Ok(kernel) = &mut self.kernel else { return Ok(()) };
        let Some(udp) = &self.udp else {
            // What an earlier daemon took is still to be taken, for a while.
            return if self.left.is_none() { Ok(kernel.set_addresses(&HashSet::new())?) } else { Ok(()) };
        };
        let taken = match udp::addresses() {
            Ok(mut addresses) => {
                addresses.retain(|address| !host_pair::is_end(&address.interface));
                udp::taken_at(udp.bound, addresses)
            }
            Err(error) => {
                tracing::warn!(%error, "the addresses of interfaces cannot be read; UDP is taken where it was");
                return Ok(());
            }
        };
        self.routing.get_or_insert_with(Routing::enable);
        let pair = udp.pair.as_ref();
        let by_pair = pair.map(|pair| LocalAddress::new(pair.addresses.switch_ip.into(), udp.bound.port()));
        kernel.set_addresses(&taken.iter().map(|(address, _)| *address).chain(by_pair).collect())?;
        // Those that are no Ethernet interfaces cannot be found.
        let interfaces = taken.iter().filter(|(_, at)| !at.loopback).map(|(_, at)| at.interface.as_str());
        let interfaces = interfaces.chain(pair.map(|pair| pair.switch.name.as_str()));
        let found = interfaces.collect::<HashSet<_>>().into_iter().filter_map(|name| Interface::find(name).ok());
        let found: HashMap<u32, String> = found.map(|interface| (interface.index, interface.name)).collect();
        let Some(udp) = &mut self.udp else { return Ok(()) };
        let (logs, before) = (udp.logs, std::mem::replace(&mut udp.devices, found.keys().copied().collect()));
        for (ifindex, name) in found.iter().filter(|(ifindex, _)| !before.contains(ifindex)) {
            let is_new = !self.devices.contains_key(ifindex);
            self.use_device(*ifindex, name, false);
            if logs && is_new {
                self.report_of(name, *ifindex).log();
            }
        }
        before
            .into_iter()
            .filter(|ifindex| !found.contains_key(ifindex))
            .for_each(|ifindex| self.leave_device(ifindex));
        Ok(())
    }

    /// Has the kernel take the tagged frames of the ports that are VLANs.
    fn follow_vlans(&mut self) -> Result<(), PlaneError> {
        if self.left.is_some() {
            // What an earlier daemon took is still to be taken.
            return Ok(());
        }
        let vlan = |port: &Port| Some(Vlan { ifindex: port.device, id: port.vlan?.into() });
        let vlans = self.ports.values().filter_map(vlan).collect();
        if let Ok(kernel) = &mut self.kernel {
            kernel.set_vlans(&vlans)?;
        }
        Ok(())
    }

    fn report_of(&self, interface: &str, device: u32) -> InterfacePlane {
        if let Some(dpdk) = self.dpdk.as_ref().and_then(|dpdk| dpdk.device_of(device)) {
            let (interface, reason) = (interface.to_owned(), format!("device {dpdk}"));
            return InterfacePlane { interface, kind: "dpdk", reason, left_alone: false };
        }
        let (attached, reason, left_alone) = self
            .devices
            .get(&device)
            .map_or((None, "", false), |device| (device.attached, device.reason.as_str(), device.left_alone));
        let kind = match attached {
            Some(Mode::Native) => "xdp-native",
            Some(Mode::Generic) => "xdp-generic",
            None => "userspace",
        };
        let leaves_in_kernel = attached.is_none() || self.kernel_can_send_to(device);
        let reason = reason.to_owned() + if leaves_in_kernel { "" } else { NO_REDIRECT };
        InterfacePlane { interface: interface.to_owned(), kind, reason, left_alone }
    }

    /// Puts the program on an interface, unless it is there. `named`: whatever that disturbs, and
    /// if need be in the generic mode.
    fn use_device(&mut self, ifindex: u32, name: &str, named: bool) {
        if self.devices.get(&ifindex).is_none_or(|device| device.attached.is_none()) {
            let (attached, reason) = self.attach_program(ifindex, name, named);
            // With somebody else's program there, naming it changes nothing.
            let left_alone = attached.is_none() && !named && self.kernel.is_ok() && !reason.starts_with(OCCUPIED);
            self.devices.insert(ifindex, Served { name: name.to_owned(), attached, reason, left_alone, sends: false });
        }
    }

    /// Takes the program off an interface that nothing uses any more.
    fn leave_device(&mut self, ifindex: u32) {
        let by_port = self.ports.values().any(|port| port.device == ifindex);
        let by_udp = self.udp.as_ref().is_some_and(|udp| udp.devices.contains(&ifindex));
        if by_port || by_udp {
            return;
        }
        let Some(device) = self.devices.remove(&ifindex) else { return };
        if let Ok(kernel) = &mut self.kernel
            && let Err(error) = kernel.detach(ifindex)
        {
            // As when the interface was deleted.
            tracing::debug!(interface = device.name, %error, "the XDP program was already gone");
        }
        if let (true, Ok(kernel)) = (device.sends, &mut self.kernel) {
            let _ = kernel.clear_port(ifindex);
        }
        if let Some(left) = &mut self.left {
            left.ports.remove(&ifindex);
        }
    }

    fn attach_program(&mut self, ifindex: u32, name: &str, named: bool) -> (Option<Mode>, String) {
        let kernel = match &mut self.kernel {
            Ok(kernel) => kernel,
            Err(reason) => return (None, reason.clone()),
        };
        match kernel.take_over(ifindex) {
            Ok(Some(mode)) => return (Some(mode), "taken over from the daemon before this one".into()),
            Ok(None) => {}
            Err(error) => {
                tracing::warn!(interface = name, %error, "the program of an earlier daemon cannot be replaced in \
                                                          place");
            }
        }
        let features = || self.features.as_ref().and_then(|features| features.of(ifindex).ok());
        if let Some(disturbance) = (!named).then(|| disturbance::of(name, features())).flatten() {
            return (None, disturbance);
        }
        let native = match kernel.attach(ifindex, Mode::Native) {
            Ok(()) => return (Some(Mode::Native), SUPPORTED.into()),
            Err(error) => error,
        };
        if kernel_errors::is_occupied(&native) {
            return (None, occupied(ifindex));
        }
        let why = kernel_errors::attach(&native);
        if !named {
            return (None, format!("no native XDP: {why}; generic XDP would slow down all that arrives there"));
        }
        match kernel.attach(ifindex, Mode::Generic) {
            Ok(()) => (Some(Mode::Generic), format!("no native XDP: {why}")),
            Err(generic) => {
                (None, format!("no native XDP: {why}; no generic XDP: {}", kernel_errors::attach(&generic)))
            }
        }
    }

    /// Tells the kernel that it may send to an interface.
    fn make_port(&mut self, ifindex: u32) -> Result<(), PlaneError> {
        let Ok(kernel) = &mut self.kernel else { return Ok(()) };
        let sends = match kernel.set_port(ifindex, ifindex) {
            // What leaves here goes through the userspace plane; and so while the interface is
            // going away.
            Err(UpdateError::PortsFull | UpdateError::Port { .. }) => false,
            result => result.map(|()| true)?,
        };
        self.devices.get_mut(&ifindex).into_iter().for_each(|device| device.sends = sends);
        Ok(())
    }

    /// The port by which the kernel can send on a link, or [`PORT_USERSPACE`].
    fn port_for(&self, entry: &LinkEntry, to: LinkAddr) -> u32 {
        let (port, sends) = match to {
            LinkAddr::Ethernet { ifindex, .. } => {
                let device = self.ports.get(&ifindex).map_or(ifindex, |port| port.device);
                (device, self.sends_to(device) || self.is_dpdk(device))
            }
            LinkAddr::Udp(_) if entry.carrier.local_mac != [0; 3] => (self.host_pair, self.sends_to(self.host_pair)),
            LinkAddr::Udp(_) => {
                let by_dpdk = self.dpdk.as_ref().is_some_and(|dpdk| dpdk.routes(entry));
                (PORT_ROUTED, by_dpdk || self.kernel_routes(&entry.carrier))
            }
        };
        if sends { port } else { PORT_USERSPACE }
    }

    /// Whether an interface is the host's side of a port of the DPDK plane.
    fn is_dpdk(&self, ifindex: u32) -> bool {
        self.dpdk.as_ref().is_some_and(|dpdk| dpdk.device_of(ifindex).is_some())
    }

    /// Whether the kernel sends to an interface.
    fn sends_to(&self, ifindex: u32) -> bool {
        match self.devices.get(&ifindex) {
            Some(device) => device.sends,
            // Not taken over yet, perhaps.
            None => self.left.as_ref().is_some_and(|left| left.ports.contains(&ifindex)),
        }
    }

    /// Whether the kernel plane can send datagrams to where a carrier says.
    fn kernel_routes(&self, carrier: &Carrier) -> bool {
        let (Ok(_), Some(routing)) = (&self.kernel, &self.routing) else { return false };
        let routes = match carrier.kind {
            Carrier::UDP4 => routing.v4.is_ok(),
            Carrier::UDP6 => routing.v6.is_ok() && carrier.flags & Carrier::ZERO_CHECKSUM != 0,
            _ => false,
        };
        routes && carrier.local_ip != [0; 4]
    }

    /// Permits come before the entry that says to look for them, and go after.
    fn set_kernel_route(
        &mut self,
        name: &Name,
        entry: FibEntry,
        permits: &[Permit],
        held: &[Permit],
    ) -> Result<(), UpdateError> {
        let Ok(kernel) = &mut self.kernel else { return Ok(()) };
        let (come, gone) = (without(permits, held), without(held, permits));
        let set = come.iter().try_for_each(|permit| kernel.permit(permit));
        match set.and_then(|()| kernel.set_route(name, entry)) {
            Ok(()) => gone.iter().try_for_each(|permit| kernel.forbid(permit)),
            Err(error) => {
                let undone = come.iter().try_for_each(|permit| kernel.forbid(permit));
                Err(undone.err().unwrap_or(error))
            }
        }
    }

    /// One name less takes copies by this group.
    fn release_group(&mut self, group: u32) {
        if self.groups.release(group) {
            self.tables.set_group(group, &[]);
            if let Ok(kernel) = &mut self.kernel {
                kernel.release_group(group);
            }
        }
    }

    fn set_all_kernel_groups(&mut self) {
        let groups: Vec<u32> = self.groups.iter().map(|(group, _)| group).collect();
        groups.into_iter().chain([NEIGHBOURS]).for_each(|group| self.set_kernel_group(group));
    }

    /// Of the groups that the links are in, or were.
    fn set_kernel_groups_of(&mut self, links: &[KeyedEntry]) {
        if links.iter().any(|link| link.role == LinkRole::Switch as u32) {
            return self.set_all_kernel_groups();
        }
        let has_one = |readers: &[u32]| links.iter().any(|link| readers.binary_search(&link.id).is_ok());
        let groups = self.groups.iter().filter(|(_, readers)| has_one(readers)).map(|(group, _)| group);
        groups.collect::<Vec<_>>().into_iter().for_each(|group| self.set_kernel_group(group));
    }

    /// Tells the kernel which links are in a group, if it has copies to make for it. What it cannot
    /// copy to is left to the userspace plane.
    fn set_kernel_group(&mut self, group: u32) {
        let Ok(kernel) = &self.kernel else { return };
        let mut members = Vec::new();
        let tables = &self.tables;
        let mut links: Vec<&LinkEntry> = tables.members(group).into_iter().filter_map(|id| tables.link(id)).collect();
        let neighbours = links.iter().filter(|link| link.role == LinkRole::Switch as u32).count();
        let makes_copies = self.groups.makes_copies(group, neighbours);
        if !makes_copies {
            links.clear();
        }
        let mut served = if kernel.has_generic() || !makes_copies { 0 } else { u64::MAX };
        for link in links {
            match self.egress_interface(link) {
                Some(interface) => members.push(Member { link: link.id, interface }),
                None if link.role == LinkRole::Switch as u32 => served &= !link.reach,
                None => served &= !self.own_bit,
            }
        }
        if let Ok(kernel) = &mut self.kernel
            && let Err(error) = kernel.set_group(group, &members, served)
        {
            tracing::warn!(group, %error, "the userspace plane copies the frames for a group of links");
        }
    }

    /// Where the kernel's copies for a link leave, if it can send them.
    fn egress_interface(&self, link: &LinkEntry) -> Option<u32> {
        let interface = match link.port {
            PORT_ROUTED => *self.routes_of_links.get(&link.id)?,
            port => port,
        };
        self.sends_to(interface).then_some(interface)
    }

    /// Asks again by which interfaces links over UDP leave; and has the kernel copy again what it
    /// left to the userspace plane since a copy found that this was not so any more.
    fn follow_routes(&mut self) {
        let links = self.tables.links().map(|(entry, _)| entry).filter(|entry| entry.port == PORT_ROUTED);
        let routed: Vec<KeyedEntry> = links.cloned().collect();
        for link in &routed {
            self.follow_route(link);
        }
        self.set_kernel_groups_of(&routed);
    }

    /// Asks by which interface a link leaves, if it is one over UDP; whether that has changed.
    fn follow_route(&mut self, link: &LinkEntry) -> bool {
        let found = match &self.kernel {
            Ok(kernel) if link.port == PORT_ROUTED => kernel.route_of(link.id),
            _ => Ok(None),
        };
        let found = found.unwrap_or_else(|error| {
            tracing::warn!(%error, "the userspace plane copies the frames for links over UDP");
            None
        });
        let before = match found {
            Some(interface) => self.routes_of_links.insert(link.id, interface),
            None => self.routes_of_links.remove(&link.id),
        };
        before != found
    }

    fn kernel_can_send_to(&self, ifindex: u32) -> bool {
        if self.kernel.is_err() {
            return false;
        }
        // What generic XDP redirects are ordinary packets, which every interface takes.
        let only_generic = self.devices.values().all(|device| device.attached != Some(Mode::Native));
        let asked = self.features.as_ref().and_then(|features| Some(features.of(ifindex).ok()?.takes_redirects()));
        only_generic || asked.unwrap_or(true)
    }

    fn adopt(&mut self, adopted: Adopted) -> Result<(), PlaneError> {
        let Adopted { config, links, routes, next_hops, ports, groups, sources } = adopted;
        (self.own_bit, self.host_pair) = (config.own_bit, config.host_pair);
        let ports = ports.into_iter().map(|(port, _)| port).collect();
        let mut left = Left { own_bit: config.own_bit, links: Vec::new(), routes: Vec::new(), next_hops, ports };
        for entry in links {
            let to = adopted_address(&entry);
            let is_udp = matches!(to, Some(LinkAddr::Udp(_)));
            if let Some(to) = to.filter(|_| is_udp || left.ports.contains(&entry.port)) {
                if entry.port == PORT_ROUTED {
                    self.routing.get_or_insert_with(Routing::enable);
                }
                self.tables.set_link(*entry, to);
                self.follow_route(&entry);
                left.links.push((entry, to));
            } else if let Ok(kernel) = &mut self.kernel {
                // Only the daemon that died knew where it leads.
                kernel.remove_link(entry.id)?;
            }
        }
        self.tables.set_own_bit(config.own_bit);
        self.tables.set_next_hops(&next_hops);
        let readers = self.adopted_readers(&groups);
        self.left = Some(left);
        let sources = self.adopted_sources(sources);
        let mut adopted: Vec<(Name, PlaneRoute)> = Vec::with_capacity(routes.len());
        // Those with a number of their own come first, so that no other takes it.
        let (numbered, others): (Vec<_>, Vec<_>) =
            routes.into_iter().partition(|(_, entry)| readers.contains_key(&entry.group));
        for (name, entry) in numbered.into_iter().chain(others) {
            let sources = sources.get(&name).cloned().unwrap_or_default();
            let route = adopted_route(&entry, readers.get(&entry.group).map(Vec::as_slice), sources);
            // By the same number, so that nothing changes for frames under way.
            let number = readers.contains_key(&entry.group).then_some(entry.group);
            self.set_route_by_group(name, &route, number)?;
            adopted.push((name, route));
        }
        // Not before the entries that say to look for permits are gone: frames go on meanwhile.
        if let Ok(kernel) = &mut self.kernel {
            let stay = adopted.iter().flat_map(|(name, route)| source_permits(name, route)).collect();
            kernel.forbid_all_but(&stay)?;
        }
        if let (Ok(kernel), used) = (&mut self.kernel, &self.groups) {
            let unused = readers.into_keys().filter(|group| used.readers(*group).is_empty());
            unused.for_each(|group| kernel.release_group(group));
        }
        if let Some(left) = &mut self.left {
            left.routes = adopted;
        }
        Ok(())
    }

    /// The links by which frames may come from each name, sorted, of those that are there.
    fn adopted_sources(&self, permits: Vec<Permit>) -> HashMap<Name, Vec<u32>> {
        let tables = &self.tables;
        let mut sources: HashMap<Name, Vec<u32>> = HashMap::new();
        for permit in permits.into_iter().filter(|permit| tables.link(permit.link).is_some()) {
            sources.entry(permit.name).or_default().push(permit.link);
        }
        sources.values_mut().for_each(|links| links.sort_unstable());
        sources
    }

    /// The local readers of each group that has any, sorted.
    fn adopted_readers(&self, groups: &[(u32, Vec<u32>)]) -> HashMap<u32, Vec<u32>> {
        let tables = &self.tables;
        let is_reader = |id: &u32| tables.link(*id).is_some_and(|link| link.role != LinkRole::Switch as u32);
        let of = |members: &[u32]| {
            let mut readers: Vec<u32> = members.iter().copied().filter(is_reader).collect();
            readers.sort_unstable();
            readers
        };
        let groups = groups.iter().map(|(group, members)| (*group, of(members)));
        groups.filter(|(group, readers)| *group != NEIGHBOURS && !readers.is_empty()).collect()
    }
}

impl Drop for Planes {
    fn drop(&mut self) {
        self.stop_threads();
        if self.left.is_none() && !std::thread::panicking() {
            self.detach_all();
        }
    }
}

/// What the data planes hold of a route, and the permits beside it.
fn entry_of(name: &Name, route: &PlaneRoute, group: u32) -> (FibEntry, Vec<Permit>) {
    let (writer_link, others) = route.writers.split_first().unwrap_or((&0, &[]));
    let entry = FibEntry {
        egress_bits: route.egress_bits,
        local_link: if let [link] = route.readers[..] { link } else { 0 },
        group,
        writer_link: *writer_link,
        egress_set: 0,
        more_writers: u8::from(!others.is_empty()),
        reserved: 0,
    };
    let writers = others.iter().map(|link| Permit { name: *name, link: *link, part: Permit::DESTINATION });
    (entry, writers.chain(source_permits(name, route)).collect())
}

/// What lets frames from a name come by its links into other domains.
fn source_permits(name: &Name, route: &PlaneRoute) -> impl Iterator<Item = Permit> {
    let name = *name;
    route.sources.iter().map(move |link| Permit { name, link: *link, part: Permit::SOURCE })
}

/// Where a link leads that an earlier daemon left, if its entry tells.
fn adopted_address(entry: &LinkEntry) -> Option<LinkAddr> {
    let carrier = &entry.carrier;
    match carrier.kind {
        Carrier::ETHERNET if entry.port < PORT_ROUTED => {
            Some(LinkAddr::Ethernet { ifindex: entry.port, mac: mac_bytes(carrier.peer_mac) })
        }
        Carrier::UDP4 | Carrier::UDP6 => {
            let ip = ip_of(carrier.kind, carrier.peer_ip);
            // A link-local address leads nowhere without its interface.
            let link_local = matches!(ip, IpAddr::V6(ip) if ip.is_unicast_link_local());
            (!link_local).then(|| LinkAddr::udp(SocketAddr::new(ip, u16::from_be(carrier.peer_port))))
        }
        _ => None,
    }
}

/// A route that an earlier daemon left. If there are several writers here, their permits cannot be
/// read back: until the RIB has said them again, every endpoint may send to the name, as itself,
/// and other domains as those they may; readers know who may write. `readers`: of its group, as far
/// as that was in the kernel.
fn adopted_route(entry: &FibEntry, readers: Option<&[u32]>, sources: Vec<u32>) -> PlaneRoute {
    let only = Some(entry.local_link).filter(|link| *link != 0);
    PlaneRoute {
        egress_bits: entry.egress_bits,
        readers: readers.map_or_else(|| only.into_iter().collect(), <[u32]>::to_vec),
        writers: match (entry.writer_link, entry.more_writers) {
            (0, _) => Vec::new(),
            (writer, 0) => vec![writer],
            _ => vec![ANY_WRITER],
        },
        sources,
    }
}

const OCCUPIED: &str = "another XDP program is attached";

/// Whose program is in the way, and what removes it.
fn occupied(ifindex: u32) -> String {
    match Device::find(ifindex).ok().and_then(|device| device.program) {
        Some(program) => format!("{OCCUPIED}: {program}; {}", program.remedy()),
        None => format!("{OCCUPIED}, and gone by now"),
    }
}

const NO_REDIRECT: &str = "; frames leave here through the userspace plane, because the interface takes no \
                           redirected frames (a \
                           veth takes them while its peer has an XDP program, or GRO on: `ethtool -K PEER gro on`)";

fn load(config: &PlaneConfig) -> Result<KernelPlane, LoadError> {
    let missing = capabilities::missing(&capabilities::XDP);
    if !missing.is_empty() {
        return Err(LoadError::NotPermitted(missing));
    }
    let object = object::Object::find(config.ebpf_object.as_deref())?;
    let pins = match &config.pins {
        Some(place) => match Pins::open(&place.bpffs, &place.switch) {
            Err(error) if error.is_bearable() => {
                tracing::warn!("forwarding ends with this daemon: {error}");
                None
            }
            pins => Some(pins?),
        },
        None => None,
    };
    KernelPlane::load_pinned(object, config.fib_capacity, pins)
}

/// A daemon that does without XDP must not have an earlier one's program forward beside it.
fn clear_left_over(config: &PlaneConfig) -> Result<(), PlaneError> {
    let Some(place) = &config.pins else { return Ok(()) };
    if pins::find(&place.bpffs)?.is_empty() {
        return Ok(());
    }
    let pins = Pins::open(&place.bpffs, &place.switch)?;
    if pins.any() {
        tracing::warn!("XDP is not used any more: removing what an earlier daemon left in the kernel");
        pins.remove()?;
    }
    Ok(())
}

#[cfg(test)]
#[path = "../tests/unit/lib.rs"]
mod tests;
