//! The kernel plane: loads the XDP object, attaches it, and writes its maps. Knows BPF, nothing of
//! sockets or links' meaning. Called by [`super::Planes`], by the kernel tests and by `bench
//! forward`.

pub use crate::attach_mode::Mode;
use crate::kernel_failures::FLOOR;
pub use crate::kernel_failures::{AttachError, LoadError, UpdateError};
use crate::map_update::{removed, update};
use std::collections::{HashMap as Table, HashSet};
use std::hash::Hash;
use std::path::Path;

use aya::maps::{Array, DevMapHash, HashMap, MapData, MapError, PerCpuArray, PerCpuHashMap, PerCpuValues};
use aya::programs::links::{FdLink, PinnedLink};
use aya::programs::xdp::{XdpLink, XdpLinkId, XdpMode};
use aya::programs::{ProgramError, ProgramFd, TestRun, TestRunOptions, Xdp};
use aya::{Ebpf, EbpfLoader};
use gdp_link::link::KeyedEntry;
use gdp_wire::replay::WORDS;
use gdp_wire::table::{CopyCount, EGRESS_SET_SIZE, link_index};
use gdp_wire::{Counter, FibEntry, LinkEntry, LocalAddress, Name, Permit, SwitchConfig, Vlan};

use super::fib::{self, Fib};
use super::group_slots::Member;
use super::kernel_groups::{GroupMaps, KernelGroups};
use super::kernel_version::KernelVersion;
use super::link_memory::{LinkMaps, LinkMemory};
use super::losses::{self, Losses, LossesError};
use super::object::Object;
use super::pins::{Pins, PinsError};
use super::tally::KernelTally;
use super::verified;

/// The first kernel whose XDP takes packets in several buffers.
const FRAGS: KernelVersion = KernelVersion(5, 18);

/// The first kernel in which a program where copies leave can look up a route.
const ROUTES_AT_EGRESS: KernelVersion = KernelVersion(6, 12);
/// The program that says where a link over UDP leads.
const ROUTE: &str = "gdp_route";

/// How the packets of an interface may lie in memory. There is a switch for each, and they do the
/// same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Buffers {
    /// In one buffer, as a driver promises that takes this switch: it refuses an MTU for which that
    /// does not hold. How long a packet is, is then known without a call into the kernel.
    One,
    /// Perhaps in several.
    Several,
}

impl Buffers {
    /// What is better comes first.
    fn known_to(version: KernelVersion) -> &'static [Self] {
        if version >= FRAGS { &[Self::One, Self::Several] } else { &[Self::One] }
    }

    fn program(self) -> &'static str {
        match self {
            Self::One => "gdp_switch_linear",
            Self::Several => "gdp_switch",
        }
    }
}

/// What a daemon found in the kernel that an earlier one left there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Adopted {
    pub config: SwitchConfig,
    pub links: Vec<KeyedEntry>,
    pub routes: Vec<(Name, FibEntry)>,
    pub next_hops: [u32; EGRESS_SET_SIZE as usize],
    /// Interfaces by port.
    pub ports: Vec<(u32, u32)>,
    /// The links of each group that the kernel holds.
    pub groups: Vec<(u32, Vec<u32>)>,
    /// On which links frames may have a name as their source, besides what those are.
    pub sources: Vec<Permit>,
}

/// The action an XDP program returned in [`KernelPlane::test_run`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    Drop,
    Pass,
    Redirect,
    Other(u32),
}

/// The switch on an interface.
struct Attached {
    link: XdpLinkId,
    mode: Mode,
    buffers: Buffers,
}

/// The loaded programs and their maps. Dropping it detaches them, unless they are pinned: then the
/// kernel forwards on until [`Self::unpin`], or a successor.
pub struct KernelPlane {
    ebpf: Ebpf,
    pins: Option<Pins>,
    /// By interface.
    attached: Table<u32, Attached>,
    /// The switches that are loaded.
    switches: &'static [Buffers],
    capacity: u32,
    links: Array<MapData, LinkEntry>,
    fib: Fib,
    permits: HashMap<MapData, Permit, u32>,
    next_hop: Array<MapData, u32>,
    config: Array<MapData, SwitchConfig>,
    ports: DevMapHash<MapData>,
    /// The program of what leaves by a port that copies leave by.
    egress: ProgramFd,
    /// The interfaces of such ports; see [`Self::set_group`].
    copied_to: HashSet<u32>,
    copy_counts: PerCpuHashMap<MapData, u32, CopyCount>,
    groups: KernelGroups,
    addresses: HashMap<MapData, LocalAddress, u32>,
    vlans: HashMap<MapData, Vlan, u32>,
    counters: PerCpuArray<MapData, u64>,
    tally: KernelTally,
    link_memory: LinkMemory,
    losses: Losses,
    /// Why lost redirects are not counted, if they are not.
    uncounted: Option<LossesError>,
}

impl KernelPlane {
    /// Loads the object and has the kernel verify the switch; attaches nothing. `capacity`: names
    /// the FIB can hold.
    pub fn load(object: impl Into<Object>, capacity: u32) -> Result<Self, LoadError> {
        Self::load_pinned(object, capacity, None)
    }

    /// As [`Self::load`], with the maps that an earlier daemon has pinned, as they are, if their
    /// layout is the one that the object wants; those that are missing are made and pinned.
    pub fn load_pinned(object: impl Into<Object>, capacity: u32, pins: Option<Pins>) -> Result<Self, LoadError> {
        let object = &object.into();
        let version = KernelVersion::running();
        if version < FLOOR {
            return Err(LoadError::OldKernel(version));
        }
        let bytes = object.bytes().map_err(|source| LoadError::Read { object: object.clone(), source })?;
        let unloaded = |source| LoadError::Object { object: object.clone(), source: Box::new(source) };
        let mut loader = EbpfLoader::new();
        loader.map_max_entries("PERMITS", capacity);
        let asks_at_egress = u32::from(version >= ROUTES_AT_EGRESS);
        loader.override_global("ASKS_AT_EGRESS", &asks_at_egress, true);
        let net_devices = losses::net_devices();
        if let Ok(net_devices) = &net_devices {
            loader.override_global(losses::WHERE, net_devices, true);
        }
        let fresh = pins.as_ref().is_none_or(|pins| !pins.any());
        let to_pin = pins.as_ref().map_or(Ok(Vec::new()), |pins| maps_to_pin(object, &bytes, capacity, pins))?;
        for name in &to_pin {
            if let Some(pins) = &pins {
                loader.map_pin_path(name, pins.map(name));
            }
        }
        let loaded =
            loader.load(&bytes).map_err(unloaded).and_then(|ebpf| Self::finish(object, version, capacity, &pins, ebpf));
        match (loaded, pins) {
            (Ok(plane), pins) => Ok(Self { pins, uncounted: net_devices.err(), ..plane }),
            (Err(error), pins) => {
                if let Some(pins) = pins.filter(|_| fresh) {
                    let _ = pins.remove();
                }
                Err(error)
            }
        }
    }

    fn finish(
        object: &Object,
        version: KernelVersion,
        capacity: u32,
        pins: &Option<Pins>,
        mut ebpf: Ebpf,
    ) -> Result<Self, LoadError> {
        let switches = Buffers::known_to(version);
        let egress = if version >= FRAGS { "gdp_egress" } else { "gdp_egress_linear" };
        for name in switches.iter().map(|buffers| buffers.program()).chain([egress, ROUTE]) {
            let program = xdp(&mut ebpf, name);
            let program = program.ok_or(LoadError::Mismatch { object: object.clone(), what: "program", name })?;
            verified::load(|| program.load())
                .map_err(|source| LoadError::Program { object: object.clone(), source: Box::new(source) })?;
        }
        let egress = || -> Result<ProgramFd, LoadError> {
            let program: &Xdp = ebpf
                .program(egress)
                .and_then(|program| program.try_into().ok())
                .ok_or(LoadError::Mismatch { object: object.clone(), what: "program", name: egress })?;
            program
                .fd()
                .and_then(|fd| Ok(fd.try_clone()?))
                .map_err(|source| LoadError::Program { object: object.clone(), source: Box::new(source) })
        };
        let (egress, of_groups) = (egress()?, egress()?);

        let groups = ebpf.take_map("GROUPS");
        let groups = groups.ok_or(LoadError::Mismatch { object: object.clone(), what: "map", name: "GROUPS" })?;
        let mut maps = Maps { ebpf: &mut ebpf, object };
        let tx_counters: Array<MapData, u64> = maps.take("TX_COUNTERS")?;
        let windows: Array<MapData, [u64; WORDS]> = maps.take("WINDOWS")?;
        let complaints: Array<MapData, u64> = maps.take("COMPLAINTS")?;
        let punts: Array<MapData, u64> = maps.take("PUNTS")?;
        let groups = GroupMaps { groups, served: maps.take("SERVED")?, places: maps.take("PLACES")? };
        let groups = KernelGroups::open(groups, of_groups, pins.as_ref().map(|pins| pins.folder().to_owned()))?;
        let shared = LinkMaps { counts: &tx_counters, windows: &windows, complaints: &complaints, punts: &punts };
        Ok(Self {
            switches,
            capacity,
            links: maps.take("LINKS")?,
            fib: Fib::open(maps.take("FIB")?, capacity, pins.as_ref())?,
            permits: maps.take("PERMITS")?,
            next_hop: maps.take("NEXT_HOP")?,
            config: maps.take("CONFIG")?,
            ports: maps.take("PORTS")?,
            egress,
            copy_counts: maps.take("COUNTED")?,
            copied_to: groups.interfaces(),
            groups,
            addresses: maps.take("ADDRESSES")?,
            vlans: maps.take("VLANS")?,
            counters: maps.take("COUNTERS")?,
            tally: KernelTally { links: maps.take("LINK_COUNTERS")?, busiest: maps.take("BUSIEST")? },
            link_memory: LinkMemory::map(shared).map_err(LoadError::LinkMemory)?,
            losses: Losses::new(maps.take(losses::MAP)?),
            uncounted: None,
            ebpf,
            pins: None,
            attached: Table::new(),
        })
    }

    /// What an earlier daemon left in the pinned maps; `None` if none did.
    pub fn adopted(&self) -> Result<Option<Adopted>, UpdateError> {
        let config = self.config.get(&0, 0).map_err(update("CONFIG"))?;
        // Written before anything else, and the ethertype is never 0.
        if self.pins.is_none() || config.ethertype == 0 {
            return Ok(None);
        }
        let mut next_hops = [0; EGRESS_SET_SIZE as usize];
        for (bit, link) in (0..).zip(&mut next_hops) {
            *link = self.next_hop.get(&bit, 0).map_err(update("NEXT_HOP"))?;
        }
        let links = self.links.iter().map(|link| link.map(KeyedEntry::from));
        let links: Vec<_> = links.collect::<Result<_, _>>().map_err(update("LINKS"))?;
        Ok(Some(Adopted {
            config,
            links: links.into_iter().filter(|link| link.id != 0).collect(),
            routes: self.routes().collect(),
            next_hops,
            ports: self.ports_there().map_err(update("PORTS"))?,
            groups: self.groups.found(),
            sources: self.permits_there()?.into_iter().filter(|permit| permit.part == Permit::SOURCE).collect(),
        }))
    }

    /// The ports whose interfaces are there, with those.
    fn ports_there(&self) -> Result<Vec<(u32, u32)>, MapError> {
        let mut there = Vec::new();
        for port in self.ports.keys() {
            let port = port?;
            // The kernel takes out an interface that is deleted.
            there.extend(self.ports.get(port, 0).ok().map(|value| (port, value.if_index)));
        }
        Ok(there)
    }

    /// Attaches the switch to an interface of this network namespace.
    pub fn attach(&mut self, ifindex: u32, mode: Mode) -> Result<(), AttachError> {
        let xdp_mode = match mode {
            Mode::Native => XdpMode::Driver,
            Mode::Generic => XdpMode::Skb,
        };
        let (buffers, mut link) =
            first_that(self.switches_for(mode), |buffers| self.switch(buffers).attach_to_if_index(ifindex, xdp_mode))?;
        if let Some(pin) = self.pins.as_ref().map(|pins| pins.link(ifindex, mode)) {
            let taken = FdLink::try_from(self.switch(buffers).take_link(link)?)?;
            let pinned = taken.pin(pin)?;
            link = self.switch(buffers).attach_to_link(XdpLink::try_from(FdLink::from(pinned))?)?;
        }
        self.attached.insert(ifindex, Attached { link, mode, buffers });
        Ok(())
    }

    /// Has the program that an earlier daemon left on an interface replaced by this one's, between
    /// two packets. `None` if there is none there.
    pub fn take_over(&mut self, ifindex: u32) -> Result<Option<Mode>, AttachError> {
        let left = self.pins.iter().flat_map(Pins::links).find(|(at, _)| *at == ifindex);
        let Some((pin, mode)) = self.pins.as_ref().zip(left).map(|(pins, (_, mode))| (pins.link(ifindex, mode), mode))
        else {
            return Ok(None);
        };
        let replaced = first_that(self.switches_for(mode), |buffers| {
            let pinned = FdLink::from(PinnedLink::from_pin(&pin)?);
            Ok::<_, AttachError>(self.switch(buffers).attach_to_link(XdpLink::try_from(pinned)?)?)
        });
        match replaced {
            Ok((buffers, link)) => {
                self.attached.insert(ifindex, Attached { link, mode, buffers });
                self.watch_losses();
                Ok(Some(mode))
            }
            // The interface was deleted, and this one has inherited its number.
            Err(AttachError::Program(ProgramError::SyscallError(error)))
                if error.io_error.raw_os_error() == Some(libc::ENOLINK) =>
            {
                unpin(&pin)?;
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    /// Takes the program off an interface. Nothing happens if there is none.
    pub fn detach(&mut self, ifindex: u32) -> Result<(), AttachError> {
        let Some(Attached { link, mode, buffers }) = self.attached.remove(&ifindex) else { return Ok(()) };
        let pin = self.pins.as_ref().map(|pins| pins.link(ifindex, mode));
        self.switch(buffers).detach(link)?;
        pin.map_or(Ok(()), |pin| unpin(&pin))
    }

    /// Takes off what an earlier daemon left on interfaces that this one has not taken over.
    pub fn drop_left_over(&mut self) -> Result<(), AttachError> {
        let Some(pins) = &self.pins else { return Ok(()) };
        let left = pins.links().into_iter().filter(|(ifindex, _)| !self.attached.contains_key(ifindex));
        left.into_iter().try_for_each(|(ifindex, mode)| unpin(&pins.link(ifindex, mode)))
    }

    /// From now on everything ends with this process.
    pub fn unpin(&mut self) -> Result<(), PinsError> {
        self.groups.unpin();
        self.fib.unpin();
        self.pins.take().map_or(Ok(()), |pins| pins.remove())
    }

    /// Whether the kernel forwards on without this process.
    pub fn is_pinned(&self) -> bool {
        self.pins.is_some()
    }

    /// Whether the kernel has compiled the switch; `None` if it does not say.
    pub fn is_jitted(&self) -> Option<bool> {
        let program: &Xdp = self.ebpf.program(self.switches[0].program())?.try_into().ok()?;
        Some(program.info().ok()?.size_jitted() != 0)
    }

    /// Makes `port` lead to an interface of this network namespace.
    pub fn set_port(&mut self, port: u32, ifindex: u32) -> Result<(), UpdateError> {
        self.count_copies_at(ifindex)?;
        self.write_port(port, ifindex)?;
        self.watch_losses();
        Ok(())
    }

    fn write_port(&mut self, port: u32, ifindex: u32) -> Result<(), UpdateError> {
        let egress = self.copied_to.contains(&ifindex).then_some(&self.egress);
        self.ports.insert(port, ifindex, egress, 0).map_err(|source| match &source {
            aya::maps::xdp::XdpMapError::MapError(error) if is_full(error) => UpdateError::PortsFull,
            _ => UpdateError::Port { port, ifindex, source },
        })
    }

    /// Does not count what is lost after redirects.
    pub fn forgo_losses(&mut self) {
        self.uncounted = Some(LossesError::Unwanted);
    }

    /// Counts what is lost between the interfaces that ports lead to. Forwarding does not depend on
    /// it.
    fn watch_losses(&mut self) {
        if self.uncounted.is_some() {
            return;
        }
        let started = self.losses.start(&mut self.ebpf, self.pins.as_ref());
        let ports = started.and_then(|()| Ok(self.ports_there()?));
        let interfaces = ports.map(|ports| ports.into_iter().map(|(_, ifindex)| ifindex).collect::<Vec<_>>());
        self.uncounted = interfaces.and_then(|interfaces| self.losses.watch(&interfaces)).err();
    }

    /// Frames that were lost after a redirect, by interface.
    pub fn losses(&self) -> Result<Table<u32, u64>, UpdateError> {
        self.losses.counts().map_err(update(losses::MAP))
    }

    /// Why [`Self::losses`] are not counted, if they are not.
    pub fn uncounted(&self) -> Option<&LossesError> {
        self.uncounted.as_ref()
    }

    /// Frames for `port` are then dropped and counted. An empty port is no error.
    pub fn clear_port(&mut self, port: u32) -> Result<(), UpdateError> {
        removed(self.ports.remove(port)).map_err(update("PORTS"))?;
        removed(self.copy_counts.remove(&port)).map_err(update("COUNTED"))
    }

    /// Makes `members` the links of a group; the kernel copies frames to them that have no other
    /// egress bits than those `served`, unless the links are too many. After an error it does not.
    ///
    /// Copies become what they are by the program where they leave, and the kernel runs the program
    /// that came with the first frame of a batch over all of it. So every port to an interface that
    /// copies leave by has the program as well, before there is a copy, and from then on. Others do
    /// without, since it costs every frame a part of what the switch does (`bench forward --only
    /// hops`).
    pub fn set_group(&mut self, group: u32, members: &[Member], served: u64) -> Result<(), UpdateError> {
        let interfaces = members.iter().map(|member| member.interface);
        let new: HashSet<u32> = interfaces.filter(|interface| !self.copied_to.contains(interface)).collect();
        let wait = !new.is_empty() && self.have_copies_leave_by(&new)?;
        self.groups.set(group, members, served, wait)
    }

    /// Gives the ports to these interfaces the program of copies; whether there are any.
    fn have_copies_leave_by(&mut self, new: &HashSet<u32>) -> Result<bool, UpdateError> {
        let mut ports = self.ports_there().map_err(update("PORTS"))?;
        ports.retain(|(_, ifindex)| new.contains(ifindex));
        self.copied_to.extend(new);
        let written = ports.iter().try_for_each(|(port, ifindex)| self.write_port(*port, *ifindex));
        if written.is_err() {
            self.copied_to.retain(|interface| !new.contains(interface));
        }
        written.map(|()| !ports.is_empty())
    }

    /// Says that no route leads to the group any more.
    pub fn release_group(&mut self, group: u32) {
        self.groups.release(group);
    }

    /// The interface by which frames for a link over UDP leave now, if the kernel can send frames
    /// of all lengths that the link takes: a port, behind which the next station is resolved.
    /// `None` as well where copies could not find it. Asked by the program's own lookup, for the
    /// calling thread's network namespace.
    pub fn route_of(&self, link: u32) -> Result<Option<u32>, ProgramError> {
        /// The shortest packet there is.
        const ETHERNET: usize = 14;
        let Some(program) = self.ebpf.program(ROUTE) else { return Ok(None) };
        let program: &Xdp = program.try_into()?;
        let mut packet = [0; ETHERNET];
        packet[..4].copy_from_slice(&link.to_ne_bytes());
        let mut options = TestRunOptions::new();
        options.data_in = Some(&packet);
        let interface = program.test_run(options)?.return_value;
        Ok((interface != 0).then_some(interface))
    }

    /// Whether frames arrive somewhere by generic XDP. What that copies shares memory, so one
    /// copy's header would be that of all.
    pub fn has_generic(&self) -> bool {
        let pinned = self.pins.iter().flat_map(Pins::links).map(|(_, mode)| mode);
        self.attached.values().map(|attached| attached.mode).chain(pinned).any(|mode| mode == Mode::Generic)
    }

    /// From now on takes frames over UDP at these addresses, and no others.
    pub fn set_addresses(&mut self, addresses: &HashSet<LocalAddress>) -> Result<(), UpdateError> {
        set_of(&mut self.addresses, addresses).map_err(update("ADDRESSES"))
    }

    /// From now on takes tagged frames on these VLANs, and no others.
    pub fn set_vlans(&mut self, vlans: &HashSet<Vlan>) -> Result<(), UpdateError> {
        set_of(&mut self.vlans, vlans).map_err(update("VLANS"))
    }

    pub fn set_config(&mut self, config: SwitchConfig) -> Result<(), UpdateError> {
        self.config.set(0, config, 0).map_err(update("CONFIG"))
    }

    /// Forgets what was counted of the link that had the index of `id` before.
    pub fn begin_link(&mut self, id: u32) -> Result<(), UpdateError> {
        self.tally.begin(id).map_err(update("LINK_COUNTERS"))
    }

    pub fn set_link(&mut self, link: &LinkEntry) -> Result<(), UpdateError> {
        self.links.set(link_index(link.id), link, 0).map_err(update("LINKS"))
    }

    pub fn remove_link(&mut self, id: u32) -> Result<(), UpdateError> {
        self.links.set(link_index(id), LinkEntry::default(), 0).map_err(update("LINKS"))
    }

    pub fn set_route(&mut self, name: &Name, entry: FibEntry) -> Result<(), UpdateError> {
        self.fib.insert(name, entry)
    }

    /// Whether the name was there.
    pub fn remove_route(&mut self, name: &Name) -> bool {
        self.fib.remove(name)
    }

    /// Lets frames of a link have a name in their header, where its entry says to look for that.
    pub fn permit(&mut self, permit: &Permit) -> Result<(), UpdateError> {
        match self.permits.insert(permit, 0, 0) {
            Err(error) if is_full(&error) => Err(UpdateError::PermitsFull { capacity: self.capacity }),
            result => result.map_err(update("PERMITS")),
        }
    }

    /// Takes back what [`Self::permit`] did; if it did not, that is no error.
    pub fn forbid(&mut self, permit: &Permit) -> Result<(), UpdateError> {
        removed(self.permits.remove(permit)).map_err(update("PERMITS"))
    }

    /// Takes back every permission but these.
    pub fn forbid_all_but(&mut self, stay: &HashSet<Permit>) -> Result<(), UpdateError> {
        let permits = self.permits_there()?;
        permits.iter().filter(|permit| !stay.contains(permit)).try_for_each(|permit| self.forbid(permit))
    }

    fn permits_there(&self) -> Result<Vec<Permit>, UpdateError> {
        self.permits.keys().collect::<Result<_, _>>().map_err(update("PERMITS"))
    }

    pub fn set_next_hops(&mut self, next_hops: &[u32; EGRESS_SET_SIZE as usize]) -> Result<(), UpdateError> {
        (0..).zip(next_hops).try_for_each(|(bit, link)| self.next_hop.set(bit, link, 0)).map_err(update("NEXT_HOP"))
    }

    /// Where a name leads.
    pub fn route(&self, name: &Name) -> Option<FibEntry> {
        self.fib.get(name)
    }

    /// What the kernel forwards by, in no order.
    pub fn routes(&self) -> impl Iterator<Item = (Name, FibEntry)> {
        self.fib.iter()
    }

    /// The counters, summed over the CPUs, in the order of [`Counter::ALL`].
    pub fn counters(&self) -> Result<[u64; Counter::COUNT], UpdateError> {
        let mut sums = [0; Counter::COUNT];
        for (index, sum) in (0..).zip(&mut sums) {
            *sum = self.counters.get(&index, 0).map_err(update("COUNTERS"))?.iter().sum();
        }
        Ok(sums)
    }

    /// What became of the frames of each link, and the busiest names.
    pub fn tally(&self) -> &KernelTally {
        &self.tally
    }

    /// The counts and windows of the links, shared with whoever else sends and receives on them.
    pub fn link_memory(&self) -> &LinkMemory {
        &self.link_memory
    }

    /// Runs the switch over one Ethernet frame without an interface; the action, and the frame as
    /// it left it.
    pub fn test_run(&mut self, buffers: Buffers, frame: &[u8]) -> Result<(Action, Vec<u8>), ProgramError> {
        // What carries it may grow.
        let mut out = vec![0; frame.len() + 64];
        let mut options = TestRunOptions::new();
        options.data_in = Some(frame);
        options.data_out = Some(&mut out);
        let result = self.switch(buffers).test_run(options)?;
        out.truncate(result.data_size_out as usize);
        let action = match result.return_value {
            1 => Action::Drop,
            2 => Action::Pass,
            4 => Action::Redirect,
            other => Action::Other(other),
        };
        Ok((action, out))
    }

    /// Nanoseconds a packet costs, over `repeat` runs on the same frame. The frame changes as it is
    /// forwarded, so only the first run sees it as given.
    pub fn time(&mut self, buffers: Buffers, frame: &[u8], repeat: u32) -> Result<u32, ProgramError> {
        let mut options = TestRunOptions::new();
        options.data_in = Some(frame);
        options.repeat = repeat;
        Ok(self.switch(buffers).test_run(options)?.duration.subsec_nanos())
    }

    /// What an earlier daemon has there stays.
    fn count_copies_at(&mut self, ifindex: u32) -> Result<(), UpdateError> {
        const NOEXIST: u64 = 1;
        let cpus = aya::util::nr_cpus().map_err(|(_, source)| update("COUNTED")(MapError::IoError(source)))?;
        let none = PerCpuValues::try_from(vec![CopyCount::default(); cpus]);
        let none = none.map_err(|source| update("COUNTED")(MapError::IoError(source)))?;
        match self.copy_counts.insert(ifindex, none, NOEXIST) {
            Err(error) if is_full(&error) => Err(UpdateError::PortsFull),
            Err(MapError::SyscallError(error)) if error.io_error.raw_os_error() == Some(libc::EEXIST) => Ok(()),
            result => result.map_err(update("COUNTED")),
        }
    }

    /// What to try on an interface, in this order.
    fn switches_for(&self, mode: Mode) -> &'static [Buffers] {
        match mode {
            Mode::Native => self.switches,
            // Here every driver takes either, but for the first the kernel would copy each large
            // packet into one buffer.
            Mode::Generic => &self.switches[self.switches.len() - 1..],
        }
    }

    fn switch(&mut self, buffers: Buffers) -> &mut Xdp {
        xdp(&mut self.ebpf, buffers.program()).expect("`load` found the program")
    }
}

struct Maps<'a> {
    ebpf: &'a mut Ebpf,
    object: &'a Object,
}

impl Maps<'_> {
    fn take<T: TryFrom<aya::maps::Map, Error = MapError>>(&mut self, map: &'static str) -> Result<T, LoadError> {
        let object = || self.object.clone();
        let found = self.ebpf.take_map(map);
        let found = found.ok_or_else(|| LoadError::Mismatch { object: object(), what: "map", name: map })?;
        T::try_from(found).map_err(|source| LoadError::Map { object: object(), map, source })
    }
}

/// What the pinned maps of a switch hold and count.
pub struct PinnedStats {
    pub links: usize,
    pub names: usize,
    pub counters: Vec<(Counter, u64)>,
    /// Frames lost after a redirect, by interface.
    pub losses: Table<u32, u64>,
}

/// Reads the maps in a folder of pins of this version. A daemon may be at work on them.
pub fn pinned_stats(folder: &Path) -> Result<PinnedStats, MapError> {
    let open = |name: &str| MapData::from_pin(folder.join(name));
    let counters: PerCpuArray<_, u64> = PerCpuArray::try_from(aya::maps::Map::PerCpuArray(open("COUNTERS")?))?;
    let links: Array<_, LinkEntry> = Array::try_from(aya::maps::Map::Array(open("LINKS")?))?;
    let counted = (0..).zip(Counter::ALL).map(|(index, counter)| Ok((*counter, counters.get(&index, 0)?.iter().sum())));
    Ok(PinnedStats {
        links: links.iter().filter(|link| link.as_ref().is_ok_and(|link| link.id != 0)).count(),
        names: fib::names_pinned(folder)?,
        counters: counted.collect::<Result<_, MapError>>()?,
        losses: losses::pinned_counts(folder)?,
    })
}

/// The names of the object's maps, after a comparison with those of them that are pinned.
fn maps_to_pin(object: &Object, bytes: &[u8], capacity: u32, pins: &Pins) -> Result<Vec<String>, LoadError> {
    let parsed = aya_obj::Object::parse(bytes).map_err(|source| LoadError::Parse { object: object.clone(), source })?;
    let mut names = Vec::new();
    for (name, map) in parsed.maps {
        // Data sections belong to the program, not to the switch.
        if name.starts_with('.') {
            continue;
        }
        let max_entries = if name == "PERMITS" { capacity } else { map.max_entries() };
        pins.check(&name, &map, max_entries)?;
        names.push(name);
    }
    Ok(names)
}

fn unpin(pin: &Path) -> Result<(), AttachError> {
    std::fs::remove_file(pin).map_err(|source| AttachError::Unpin { path: pin.into(), source })
}

/// The first switch with which something succeeds, and what came of it; or why it did not with the
/// last.
fn first_that<T, E>(switches: &[Buffers], mut attempt: impl FnMut(Buffers) -> Result<T, E>) -> Result<(Buffers, T), E> {
    let (last, others) = switches.split_last().expect("one is loaded at least");
    let early = others.iter().find_map(|buffers| attempt(*buffers).ok().map(|done| (*buffers, done)));
    early.map_or_else(|| attempt(*last).map(|done| (*last, done)), Ok)
}

fn xdp<'a>(ebpf: &'a mut Ebpf, program: &str) -> Option<&'a mut Xdp> {
    ebpf.program_mut(program)?.try_into().ok()
}

fn is_full(error: &MapError) -> bool {
    matches!(error, MapError::SyscallError(error) if error.io_error.raw_os_error() == Some(libc::E2BIG))
}

/// Makes the keys of a map these.
fn set_of<K: aya::Pod + Eq + Hash>(map: &mut HashMap<MapData, K, u32>, keys: &HashSet<K>) -> Result<(), MapError> {
    let held: HashSet<K> = map.keys().collect::<Result<_, _>>()?;
    held.difference(keys).try_for_each(|key| removed(map.remove(key)))?;
    keys.difference(&held).try_for_each(|key| map.insert(key, 0, 0))
}
