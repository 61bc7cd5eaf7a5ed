//! Owner of all planes of a daemon, and of the interfaces on which frames arrive.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use gdp_core::name::NamePrefix;
use gdp_link::link::KeyedEntry;
use gdp_link::port::{DataSocket, HostPair, Interface, LinkAddr, UDP_MTU};
use gdp_wire::table::{ANY_WRITER, EGRESS_SET_SIZE, NEIGHBOURS, PORT_USERSPACE};
use gdp_wire::{Counter, FibEntry, Header, LinkEntry, Name, Permit};

use crate::adoption::{self, Left};
use crate::config::{PlaneConfig, PlaneError, Wanted};
use crate::data_plane::{DataPlane, FastPath};
use crate::dispatcher::Dispatcher;
use crate::dpdk::{self, DeviceCounters};
use crate::forwarder_state::Medium;
use crate::host_pair::Ends;
use crate::interface_plane::InterfacePlane;
use crate::kernel_failures::LoadError;
use crate::link_memory::LinkMemory;
use crate::notices::Notices;
use crate::ports::{Port, Ports};
use crate::route::PlaneRoute;
use crate::tally;
use crate::userspace_plane::UserspacePlane;
use crate::xdp::{XdpPlane, clear_left_over};

/// All planes of a daemon. Dropping it detaches the XDP programs and ends the threads. State taken
/// over from an earlier daemon remains in the kernel until the adoption has ended.
///
/// Call all methods that change it in the network namespace of its interfaces, because the kernel
/// identifies interfaces by index.
pub struct Planes {
    wanted: Wanted,
    state: Dispatcher,
    ports: Ports,
    left: Option<Left>,
}

impl Planes {
    /// Loads all available planes. Fails if XDP or DPDK was requested explicitly and cannot be
    /// loaded, or if the state of an earlier daemon cannot be taken over.
    pub fn open(config: PlaneConfig) -> Result<Self, PlaneError> {
        let xdp = match config.wanted {
            Wanted::Userspace => Err("`--no-xdp` or `data_plane: userspace` turns it off".to_owned()),
            Wanted::Dpdk => Err(dpdk::NOT_A_PORT.to_owned()),
            Wanted::Xdp => Ok(XdpPlane::load(&config)?),
            Wanted::Auto => match XdpPlane::load(&config) {
                // Another program already forwards, and this daemon must not stop it.
                Err(LoadError::Pins(error)) => return Err(error.into()),
                loaded => loaded.map_err(|error| error.to_string()),
            },
        };
        if xdp.is_err() {
            clear_left_over(&config)?;
        }
        let link_memory = xdp.as_ref().map_or_else(|_| LinkMemory::new(), |xdp| xdp.link_memory().clone());
        let userspace = UserspacePlane::new(link_memory, config.fib_capacity)?;
        let fast_path = match (config.wanted, &config.dpdk_settings) {
            (Wanted::Dpdk, _) => Ok(dpdk::start(&config, &userspace)?),
            (_, settings) => {
                settings.iter().for_each(|file| dpdk::restore_settings(file));
                xdp.map(|xdp| Box::new(xdp) as Box<dyn FastPath>)
            }
        };
        let mut state = Dispatcher::new(userspace, fast_path, config.fib_capacity);
        let adopted = state.fast_path.as_mut().map_or(Ok(None), |fast_path| fast_path.begin_adoption())?;
        let left = adopted.map(|adopted| adoption::adopt(&mut state, adopted)).transpose()?;
        if left.is_none() {
            state.set_own_bit(0)?;
        }
        state.set_group(NEIGHBOURS);
        Ok(Self { wanted: config.wanted, state, ports: Ports::default(), left })
    }

    /// Returns the state taken over from an earlier daemon. It is in the tables until it is
    /// replaced or removed, or until [`Self::end_adoption`].
    pub fn left(&self) -> Option<&Left> {
        self.left.as_ref()
    }

    /// Ends the adoption: removes the remaining state of an earlier daemon, except links and
    /// routes. The caller owns those.
    pub fn end_adoption(&mut self) -> Result<(), PlaneError> {
        if self.left.take().is_none() {
            return Ok(());
        }
        self.state.on_fast_path(|fast_path| fast_path.end_adoption())?;
        self.refresh()?;
        self.state.set_all_groups();
        Ok(())
    }

    /// Serves an interface of the calling thread's network namespace by the best available plane. A
    /// VLAN is served on its lower interface, because native XDP runs only there.
    pub fn attach(&mut self, interface: &Interface, socket: Arc<DataSocket>) -> Result<InterfacePlane, PlaneError> {
        self.detach(interface.index);
        let port = Port::from(interface);
        let device = port.device;
        if let Ok(fast_path) = &mut self.state.fast_path
            && let Err(reason) = fast_path.attach(device, &port.device_name)
            && self.wanted == Wanted::Xdp
        {
            self.leave_device(device);
            return Err(PlaneError::NoXdp { interface: port.interface, reason });
        }
        let medium = Medium::Ethernet(interface.index);
        let started = self.state.userspace.attach(medium, socket, interface.mtu as usize);
        if let Err(source) = started {
            self.leave_device(device);
            return Err(PlaneError::Thread { interface: interface.name.clone(), source });
        }
        self.ports.insert(interface.index, port);
        self.refresh()?;
        self.state.set_all_groups();
        Ok(self.describe(&interface.name, device))
    }

    /// Stops serving an interface; frames that arrive there are no longer forwarded. An unknown
    /// interface is no error.
    pub fn detach(&mut self, ifindex: u32) {
        if let Some(port) = self.ports.remove(ifindex) {
            self.leave_device(port.device);
            self.state.userspace.detach(Medium::Ethernet(ifindex));
            self.state.set_all_groups();
        }
    }

    /// Stops serving all interfaces, and leaves no state in the kernel.
    pub fn detach_all(&mut self) {
        self.state.userspace.stop_threads();
        for (ifindex, port) in self.ports.take() {
            self.leave_device(port.device);
            self.state.userspace.detach(Medium::Ethernet(ifindex));
        }
        self.detach_udp();
        self.left = None;
        if let Ok(mut fast_path) = std::mem::replace(&mut self.state.fast_path, Err("it was detached".into())) {
            fast_path.unpin();
        }
    }

    /// Returns whether the kernel continues to forward when this process ends.
    pub fn outlives(&self) -> bool {
        self.state.fast_path.as_ref().is_ok_and(|fast_path| fast_path.outlives())
    }

    /// Serves UDP at `bound`, by the fast path where possible. `pair`: the host pair for endpoints
    /// on this host.
    pub fn attach_udp(
        &mut self,
        socket: Arc<DataSocket>,
        bound: SocketAddr,
        pair: Option<Ends>,
    ) -> Result<Vec<InterfacePlane>, PlaneError> {
        self.detach_udp();
        let started = self.state.userspace.attach(Medium::Udp, socket, UDP_MTU as usize);
        started.map_err(|source| PlaneError::Thread { interface: "udp".into(), source })?;
        self.state.on_fast_path(|fast_path| fast_path.attach_udp(bound, pair))?;
        self.state.set_all_groups();
        self.refresh()?;
        Ok(self.udp_devices().into_iter().map(|(device, name)| self.describe(&name, device)).collect())
    }

    fn detach_udp(&mut self) {
        if let Ok(fast_path) = &mut self.state.fast_path {
            fast_path.detach_udp();
        }
        self.state.userspace.detach(Medium::Udp);
    }

    fn udp_devices(&self) -> Vec<(u32, String)> {
        self.state.fast_path.as_ref().map_or_else(|_| Vec::new(), |fast_path| fast_path.udp_devices())
    }

    /// Returns whether XDP programs are available, or the reason why not.
    pub fn xdp(&self) -> Result<(), String> {
        self.state.fast_path.as_ref().map_err(String::clone)?.xdp()
    }

    /// Returns whether endpoints on this host can bypass the daemon. This needs a kernel plane, and
    /// `bound` must be the address for endpoints.
    pub fn takes_pair(&self, bound: SocketAddr) -> Result<(), String> {
        self.xdp()?;
        // Datagrams that the kernel plane leaves to the daemon arrive at the host's address on the
        // pair.
        let any = bound.ip().is_unspecified();
        any.then_some(()).ok_or_else(|| format!("the UDP address is {bound}, and not 0.0.0.0 or [::]"))
    }

    /// Returns the host pair between the kernel plane and endpoints on this host, if it currently
    /// works.
    pub fn host_pair(&self) -> Option<HostPair> {
        self.state.fast_path.as_ref().ok()?.host_pair()
    }

    /// Returns the plane of each interface and the reason, sorted by interface name.
    pub fn report(&self) -> Vec<InterfacePlane> {
        let mut report: Vec<_> = self.ports.iter().map(|port| self.describe(&port.interface, port.device)).collect();
        let udp = self.udp_devices().into_iter();
        let others = udp.filter(|(_, name)| self.ports.iter().all(|port| port.interface != *name));
        report.extend(others.map(|(device, name)| self.describe(&name, device)));
        report.sort_by(|a, b| a.interface.cmp(&b.interface));
        report
    }

    /// Returns, for IPv4 and IPv6, the reason why links over UDP use the userspace plane, if they
    /// do.
    pub fn udp_in_userspace(&self) -> [Option<String>; 2] {
        match &self.state.fast_path {
            Ok(fast_path) => fast_path.udp_in_userspace(),
            Err(reason) => [Some(reason.clone()), Some(reason.clone())],
        }
    }

    /// Adds or replaces a link. Its frames are sent to `to`. This method sets `entry.port`.
    pub fn set_link(&mut self, entry: LinkEntry, to: LinkAddr) -> Result<(), PlaneError> {
        Ok(self.state.set_link(entry, to, self.ports.device_of(to))?)
    }

    /// Returns the number of frames sent on a link by all planes.
    pub fn frames_sent(&self, id: u32) -> u64 {
        self.state.userspace.link_memory.sent(id)
    }

    /// Sends an echo request to the data plane of the neighbour on a link.
    pub fn ask(&self, link: u32, cookie: u64) {
        self.state.userspace.send_own(link, Header::echo(cookie), &[]);
    }

    /// Sends a probe (see [`Header::probe`]) to the neighbour on a link.
    pub fn probe(&self, link: u32, probe: Header, cookie: u64) {
        self.state.userspace.send_own(link, probe, &cookie.to_be_bytes());
    }

    /// Returns the notices from neighbours to this node.
    pub fn notices(&self) -> &Arc<Notices> {
        &self.state.userspace.shared.notices
    }

    /// Removes a link. An unknown link is no error.
    pub fn remove_link(&mut self, id: u32) -> Result<(), PlaneError> {
        Ok(self.state.remove_link(id)?)
    }

    /// Returns all links of the planes.
    pub fn links(&self) -> Vec<KeyedEntry> {
        self.state.userspace.tables.links().map(|(entry, _)| entry.clone()).collect()
    }

    /// Adds or replaces the route of a name. If the FIB is full, nothing changes. All planes have
    /// the same capacity.
    pub fn set_route(&mut self, name: Name, route: &PlaneRoute) -> Result<(), PlaneError> {
        Ok(self.state.set_route(name, route, None)?)
    }

    /// Removes a route. An unknown name is no error.
    pub fn remove_route(&mut self, name: &Name) -> Result<(), PlaneError> {
        Ok(self.state.remove_route(name)?)
    }

    /// Returns the route of a name, as set in the planes.
    pub fn route(&self, name: &Name) -> Option<FibEntry> {
        self.state.userspace.tables.route(name)
    }

    /// Returns at most `limit` routed names with this prefix.
    pub fn names_like(&self, prefix: &NamePrefix, limit: usize) -> Vec<Name> {
        let names = self.state.userspace.tables.routes().map(|(name, _)| name).filter(|name| prefix.matches(name));
        names.take(limit).collect()
    }

    /// Returns the link toward the switch with this egress bit; 0 for none.
    pub fn next_hop(&self, bit: u8) -> u32 {
        self.state.userspace.tables.next_hop(bit.into())
    }

    /// Returns the links that may send to a name.
    pub fn writers(&self, name: &Name) -> Vec<u32> {
        let tables = &self.state.userspace.tables;
        let first = tables.route(name).map(|entry| entry.writer_link).filter(|link| ![0, ANY_WRITER].contains(link));
        let others = tables.permits(name).iter().filter(|permit| permit.part == Permit::DESTINATION);
        first.into_iter().chain(others.map(|permit| permit.link)).collect()
    }

    /// Returns the links of the local readers of a name.
    pub fn readers(&self, entry: &FibEntry) -> Vec<u32> {
        self.state.groups.readers(entry.group).to_vec()
    }

    /// Returns the name of the fast path: `dpdk`, or `kernel`, also if no program is attached.
    pub fn first_plane(&self) -> &'static str {
        self.state.fast_path.as_ref().map_or("kernel", |fast_path| fast_path.name())
    }

    /// Returns whether the fast path can send on a link frames that it received, without the
    /// userspace plane.
    pub fn first_plane_sends_on(&self, id: u32) -> bool {
        self.state.fast_path.is_ok()
            && self.state.userspace.tables.link(id).is_some_and(|link| link.port != PORT_USERSPACE)
    }

    /// Sets the link toward each egress switch by its egress bit; 0 for none.
    pub fn set_next_hops(&mut self, next_hops: &[u32; EGRESS_SET_SIZE as usize]) -> Result<(), PlaneError> {
        Ok(self.state.on_each(|plane| plane.set_next_hops(next_hops))?)
    }

    /// Sets this switch's own egress bit; 0 until it has one.
    pub fn set_own_bit(&mut self, own_bit: u64) -> Result<(), PlaneError> {
        Ok(self.state.set_own_bit(own_bit)?)
    }

    /// Returns the device counters of the DPDK plane, by the name of the host's interface.
    pub fn dpdk_devices(&self) -> HashMap<String, DeviceCounters> {
        self.state.fast_path.as_ref().map_or_else(|_| HashMap::new(), |fast_path| fast_path.device_counters())
    }

    /// Returns the processor time that each loop of the DPDK plane has used; empty without DPDK.
    pub fn dpdk_processor_time(&self) -> Vec<Duration> {
        self.state.fast_path.as_ref().map_or_else(|_| Vec::new(), |fast_path| fast_path.processor_time())
    }

    /// Returns each counter with the counts of [`Self::first_plane`] and of the userspace plane.
    pub fn counters(&self) -> Result<Vec<(Counter, u64, u64)>, PlaneError> {
        let first = self.state.fast_path.as_ref().map_or(Ok([0; Counter::COUNT]), |fast_path| fast_path.counters())?;
        let userspace = self.state.userspace.counters()?;
        Ok(Counter::ALL.iter().zip(first.into_iter().zip(userspace)).map(|(c, (f, u))| (*c, f, u)).collect())
    }

    /// Returns the outcomes of the frames that arrived on a link, summed over the planes, in the
    /// order of [`Counter::ALL`].
    pub fn arrivals(&self, link: u32) -> Result<tally::LinkCounters, PlaneError> {
        let mut sums = [0; Counter::COUNT];
        for plane in self.state.each() {
            sums.iter_mut().zip(plane.arrivals(link)?).for_each(|(sum, frames)| *sum += frames);
        }
        Ok(sums)
    }

    /// Returns the busiest names in descending order, each with the approximate number of frames
    /// sent for it.
    pub fn busiest(&self, limit: usize) -> Result<Vec<(Name, u64)>, PlaneError> {
        let mut sums: HashMap<Name, u64> = HashMap::new();
        for plane in self.state.each() {
            plane.busiest()?.into_iter().for_each(|(name, frames)| *sums.entry(name).or_default() += frames);
        }
        let mut names: Vec<_> = sums.into_iter().collect();
        names.sort_unstable_by_key(|(name, frames)| (std::cmp::Reverse(*frames), *name));
        names.truncate(limit);
        Ok(names)
    }

    /// Returns the frames lost after a redirect, by the name of their egress interface; or the
    /// reason why they are unknown.
    pub fn losses(&self) -> Result<HashMap<String, u64>, String> {
        self.state.fast_path.as_ref().map_or_else(|_| Ok(HashMap::new()), |fast_path| fast_path.losses())
    }

    /// Returns the active routes, read back from the kernel where XDP runs.
    pub fn routes(&self) -> Result<Vec<(Name, FibEntry)>, PlaneError> {
        Ok(self.routes_behind(None, usize::MAX)?.0)
    }

    /// Returns at most `limit` of [`Self::routes`] after the name `after`, in byte order, and
    /// whether there are more.
    pub fn routes_behind(
        &self,
        after: Option<Name>,
        limit: usize,
    ) -> Result<(Vec<(Name, FibEntry)>, bool), PlaneError> {
        let behind = |name: &Name| after.is_none_or(|after| name.as_bytes() > after.as_bytes());
        let mut routes: Vec<_> = self.state.userspace.tables.routes().filter(|(name, _)| behind(name)).collect();
        let order = |a: &(Name, FibEntry), b: &(Name, FibEntry)| a.0.as_bytes().cmp(b.0.as_bytes());
        let more = routes.len() > limit;
        if more {
            routes.select_nth_unstable_by(limit, order);
            routes.truncate(limit);
        }
        routes.sort_unstable_by(order);
        match &self.state.fast_path {
            Ok(fast_path) => Ok((fast_path.read_back(routes), more)),
            Err(_) => Ok((routes, more)),
        }
    }

    /// Updates UDP addresses, interfaces that accept redirected frames, and egress interfaces of
    /// links over UDP. Moves links and groups to the plane that can send for them. This is cheap.
    /// The daemon should call it periodically, and after changes to interfaces, in the network
    /// namespace of those interfaces.
    pub fn refresh(&mut self) -> Result<(), PlaneError> {
        let Ok(fast_path) = &mut self.state.fast_path else { return Ok(()) };
        let links = self.state.userspace.tables.links().map(|(entry, _)| entry);
        fast_path.begin_refresh(&self.ports.vlans(), &mut { links })?;
        let links: Vec<_> = self.state.userspace.tables.links().cloned().collect();
        for (entry, to) in links {
            let device = self.ports.device_of(to);
            if self.state.port_for(&entry, device) != entry.port {
                self.state.set_link(*entry, to, device)?;
            }
        }
        self.state.follow_routes();
        Ok(self.state.on_fast_path(|fast_path| fast_path.end_refresh())?)
    }

    fn describe(&self, interface: &str, device: u32) -> InterfacePlane {
        match &self.state.fast_path {
            Ok(fast_path) => fast_path.describe(interface, device),
            Err(reason) => InterfacePlane::userspace(interface, reason),
        }
    }

    /// Removes a device from the fast path if no port uses it any more.
    fn leave_device(&mut self, device: u32) {
        if let (Ok(fast_path), false) = (&mut self.state.fast_path, self.ports.uses(device)) {
            fast_path.detach(device);
        }
    }
}

impl Drop for Planes {
    fn drop(&mut self) {
        self.state.userspace.stop_threads();
        if self.left.is_none() && !std::thread::panicking() {
            self.detach_all();
        }
    }
}

#[cfg(test)]
#[path = "../tests/unit/planes.rs"]
mod tests;
