//! The kernel plane: loads the XDP object and writes its maps. It handles BPF, but neither sockets
//! nor the meaning of links. [`super::xdp`], the kernel tests and `bench forward` call it.

pub use crate::attach_mode::Mode;
use crate::kernel_failures::FLOOR;
pub use crate::kernel_failures::{AttachError, LoadError, UpdateError};
use crate::kernel_programs::Programs;
pub use crate::kernel_programs::{Buffers, XdpAction};
use crate::map_update::{removed, update};
use std::collections::{HashMap as Table, HashSet};
use std::hash::Hash;
use std::path::Path;

use aya::maps::{Array, DevMapHash, HashMap, MapData, MapError, PerCpuArray, PerCpuHashMap, PerCpuValues};
use aya::programs::ProgramFd;
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

/// First kernel in which an egress program can look up a route.
const ROUTES_AT_EGRESS: KernelVersion = KernelVersion(6, 12);
/// State of an earlier daemon that this daemon found in the kernel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Adopted {
    pub config: SwitchConfig,
    pub links: Vec<KeyedEntry>,
    pub routes: Vec<(Name, FibEntry)>,
    pub next_hops: [u32; EGRESS_SET_SIZE as usize],
    /// Ports, each with its interface.
    pub ports: Vec<(u32, u32)>,
    /// The links of each group in the kernel.
    pub groups: Vec<(u32, Vec<u32>)>,
    /// Permits for names as the source of frames, by link.
    pub sources: Vec<Permit>,
}

/// The loaded programs and their maps. Dropping this value detaches the programs unless they are
/// pinned. Pinned programs continue to forward until [`Self::unpin`], or until a successor replaces
/// them.
pub struct KernelPlane {
    pub programs: Programs,
    capacity: u32,
    links: Array<MapData, LinkEntry>,
    fib: Fib,
    permits: HashMap<MapData, Permit, u32>,
    next_hop: Array<MapData, u32>,
    config: Array<MapData, SwitchConfig>,
    ports: DevMapHash<MapData>,
    /// The egress program of ports by which copies leave.
    egress: ProgramFd,
    /// The interfaces of these ports; see [`Self::set_group`].
    copied_to: HashSet<u32>,
    copy_counts: PerCpuHashMap<MapData, u32, CopyCount>,
    groups: KernelGroups,
    addresses: HashMap<MapData, LocalAddress, u32>,
    vlans: HashMap<MapData, Vlan, u32>,
    counters: PerCpuArray<MapData, u64>,
    tally: KernelTally,
    link_memory: LinkMemory,
    losses: Losses,
    /// Reason why losses after a redirect are not counted, if any.
    uncounted: Option<LossesError>,
}

impl KernelPlane {
    /// Loads the object, which the kernel verifies, and attaches nothing. `capacity`: maximum
    /// number of names in the FIB.
    pub fn load(object: impl Into<Object>, capacity: u32) -> Result<Self, LoadError> {
        Self::load_pinned(object, capacity, None)
    }

    /// Loads the object as [`Self::load`] does, with the pinned maps of an earlier daemon,
    /// unchanged. Their layout must match the object. Missing maps are created and pinned.
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
            (Ok(mut plane), pins) => {
                (plane.programs.pins, plane.uncounted) = (pins, net_devices.err());
                Ok(plane)
            }
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
        ebpf: Ebpf,
    ) -> Result<Self, LoadError> {
        let mut programs = Programs::load(object, version, ebpf)?;
        let (egress, of_groups) = (programs.egress(object)?, programs.egress(object)?);
        let groups = programs.ebpf.take_map("GROUPS");
        let groups = groups.ok_or(LoadError::Mismatch { object: object.clone(), what: "map", name: "GROUPS" })?;
        let mut maps = Maps { ebpf: &mut programs.ebpf, object };
        let tx_counters: Array<MapData, u64> = maps.take("TX_COUNTERS")?;
        let windows: Array<MapData, [u64; WORDS]> = maps.take("WINDOWS")?;
        let complaints: Array<MapData, u64> = maps.take("COMPLAINTS")?;
        let punts: Array<MapData, u64> = maps.take("PUNTS")?;
        let groups = GroupMaps { groups, served: maps.take("SERVED")?, slots: maps.take("SLOTS")? };
        let groups = KernelGroups::open(groups, of_groups, pins.as_ref().map(|pins| pins.folder().to_owned()))?;
        let shared = LinkMaps { counts: &tx_counters, windows: &windows, complaints: &complaints, punts: &punts };
        Ok(Self {
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
            programs,
        })
    }

    /// Returns the state of an earlier daemon in the pinned maps; `None` if there is none.
    pub fn adopted(&self) -> Result<Option<Adopted>, UpdateError> {
        let config = self.config.get(&0, 0).map_err(update("CONFIG"))?;
        // A daemon writes CONFIG first, and the ethertype is never 0.
        if self.programs.pins.is_none() || config.ethertype == 0 {
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

    /// Returns the ports whose interfaces exist, with these interfaces.
    fn ports_there(&self) -> Result<Vec<(u32, u32)>, MapError> {
        let mut there = Vec::new();
        for port in self.ports.keys() {
            let port = port?;
            // The kernel has removed a deleted interface.
            there.extend(self.ports.get(port, 0).ok().map(|value| (port, value.if_index)));
        }
        Ok(there)
    }

    /// Takes over the program of an earlier daemon, as [`Programs::take_over`] does.
    pub fn take_over(&mut self, ifindex: u32) -> Result<Option<Mode>, AttachError> {
        let mode = self.programs.take_over(ifindex)?;
        if mode.is_some() {
            self.watch_losses();
        }
        Ok(mode)
    }

    /// Removes all pins, so that all state ends with this process.
    pub fn unpin(&mut self) -> Result<(), PinsError> {
        self.groups.unpin();
        self.fib.unpin();
        self.programs.pins.take().map_or(Ok(()), |pins| pins.remove())
    }

    /// Returns whether the kernel continues to forward without this process.
    pub fn is_pinned(&self) -> bool {
        self.programs.pins.is_some()
    }

    /// Maps `port` to an interface of this network namespace.
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

    /// Disables the counting of losses after redirects.
    pub fn forgo_losses(&mut self) {
        self.uncounted = Some(LossesError::Unwanted);
    }

    /// Counts losses between the interfaces of the ports. Forwarding does not depend on these
    /// counts.
    fn watch_losses(&mut self) {
        if self.uncounted.is_some() {
            return;
        }
        let started = self.losses.start(&mut self.programs.ebpf, self.programs.pins.as_ref());
        let ports = started.and_then(|()| Ok(self.ports_there()?));
        let interfaces = ports.map(|ports| ports.into_iter().map(|(_, ifindex)| ifindex).collect::<Vec<_>>());
        self.uncounted = interfaces.and_then(|interfaces| self.losses.watch(&interfaces)).err();
    }

    /// Returns the frames lost after a redirect, by interface.
    pub fn losses(&self) -> Result<Table<u32, u64>, UpdateError> {
        self.losses.counts().map_err(update(losses::MAP))
    }

    /// Returns why [`Self::losses`] are not counted, if they are not.
    pub fn uncounted(&self) -> Option<&LossesError> {
        self.uncounted.as_ref()
    }

    /// Removes a port. Frames to it are then dropped and counted. A port that is not set is no
    /// error.
    pub fn clear_port(&mut self, port: u32) -> Result<(), UpdateError> {
        removed(self.ports.remove(port)).map_err(update("PORTS"))?;
        removed(self.copy_counts.remove(&port)).map_err(update("COUNTED"))
    }

    /// Sets the links of a group. The kernel copies a frame to them if the frame has no egress bits
    /// besides `served` and the group is small enough. After an error the kernel does not copy.
    ///
    /// The egress program rewrites each copy where it leaves. For a batch of frames the kernel runs
    /// the program that belongs to the first frame. So every port to an interface with copies gets
    /// the egress program before the first copy, and retains it. Other ports omit the program,
    /// because it repeats part of the switch's work for every frame (`bench forward --only hops`).
    pub fn set_group(&mut self, group: u32, members: &[Member], served: u64) -> Result<(), UpdateError> {
        let interfaces = members.iter().map(|member| member.interface);
        let new: HashSet<u32> = interfaces.filter(|interface| !self.copied_to.contains(interface)).collect();
        let wait = !new.is_empty() && self.have_copies_leave_by(&new)?;
        self.groups.set(group, members, served, wait)
    }

    /// Sets the egress program on the ports to these interfaces. Returns whether there are any.
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

    /// Releases a group that no route uses any more.
    pub fn release_group(&mut self, group: u32) {
        self.groups.release(group);
    }

    /// Accepts frames over UDP at exactly these addresses from now on.
    pub fn set_addresses(&mut self, addresses: &HashSet<LocalAddress>) -> Result<(), UpdateError> {
        set_of(&mut self.addresses, addresses).map_err(update("ADDRESSES"))
    }

    /// Accepts tagged frames on exactly these VLANs from now on.
    pub fn set_vlans(&mut self, vlans: &HashSet<Vlan>) -> Result<(), UpdateError> {
        set_of(&mut self.vlans, vlans).map_err(update("VLANS"))
    }

    pub fn set_config(&mut self, config: SwitchConfig) -> Result<(), UpdateError> {
        self.config.set(0, config, 0).map_err(update("CONFIG"))
    }

    /// Clears the counters of the link that previously had the index of `id`.
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

    /// Removes a route. Returns whether the name was present.
    pub fn remove_route(&mut self, name: &Name) -> bool {
        self.fib.remove(name)
    }

    /// Permits a name in the header of frames on a link. Programs check permits only if the FIB
    /// entry requires it.
    pub fn permit(&mut self, permit: &Permit) -> Result<(), UpdateError> {
        match self.permits.insert(permit, 0, 0) {
            Err(error) if is_full(&error) => Err(UpdateError::PermitsFull { capacity: self.capacity }),
            result => result.map_err(update("PERMITS")),
        }
    }

    /// Revokes a permit. A missing permit is no error.
    pub fn forbid(&mut self, permit: &Permit) -> Result<(), UpdateError> {
        removed(self.permits.remove(permit)).map_err(update("PERMITS"))
    }

    /// Revokes all permits except these.
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

    /// Returns the route of a name.
    pub fn route(&self, name: &Name) -> Option<FibEntry> {
        self.fib.get(name)
    }

    /// Returns the routes that the kernel forwards by, in no particular order.
    pub fn routes(&self) -> impl Iterator<Item = (Name, FibEntry)> {
        self.fib.iter()
    }

    /// Returns the counters, summed over the CPUs, in the order of [`Counter::ALL`].
    pub fn counters(&self) -> Result<[u64; Counter::COUNT], UpdateError> {
        let mut sums = [0; Counter::COUNT];
        for (index, sum) in (0..).zip(&mut sums) {
            *sum = self.counters.get(&index, 0).map_err(update("COUNTERS"))?.iter().sum();
        }
        Ok(sums)
    }

    /// Returns the outcomes of each link's frames, and the busiest names.
    pub fn tally(&self) -> &KernelTally {
        &self.tally
    }

    /// Returns the sequence numbers and replay windows of the links. All planes that send and
    /// receive on a link share them.
    pub fn link_memory(&self) -> &LinkMemory {
        &self.link_memory
    }

    /// Starts the copy counters of an interface. Existing counters of an earlier daemon remain.
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

/// Contents and counters of a switch's pinned maps.
pub struct PinnedStats {
    pub links: usize,
    pub names: usize,
    pub counters: Vec<(Counter, u64)>,
    /// Frames lost after a redirect, by interface.
    pub losses: Table<u32, u64>,
}

/// Reads the maps in a folder of pins of this version. A daemon may be changing them.
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

/// Returns the names of the object's maps, after checking pinned maps against the object.
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

fn is_full(error: &MapError) -> bool {
    matches!(error, MapError::SyscallError(error) if error.io_error.raw_os_error() == Some(libc::E2BIG))
}

/// Makes `keys` exactly the keys of a map.
fn set_of<K: aya::Pod + Eq + Hash>(map: &mut HashMap<MapData, K, u32>, keys: &HashSet<K>) -> Result<(), MapError> {
    let held: HashSet<K> = map.keys().collect::<Result<_, _>>()?;
    held.difference(keys).try_for_each(|key| removed(map.remove(key)))?;
    keys.difference(&held).try_for_each(|key| map.insert(key, 0, 0))
}
