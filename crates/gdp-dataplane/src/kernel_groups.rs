//! The groups of links to which the kernel copies frames. This module writes the maps of
//! `gdp-ebpf/src/groups.rs` by the rules stated there. It does not handle names, nor decide the
//! members of a group. [`super::kernel`] calls it.
//!
//! The device map of a group is created on first use and then retained. Inserting it into the outer
//! map takes an RCU grace period (8 ms). Several maps are inserted together in one grace period. If
//! maps are pinned, each device map is pinned too, because opening it from the outer map needs
//! CAP_SYS_ADMIN.

pub use crate::kernel_failures::OpenError;
use std::collections::{BTreeMap, HashSet};
use std::io;
use std::os::fd::{AsFd, AsRawFd};
use std::path::{Path, PathBuf};

use aya::maps::{Array, ArrayOfMaps, DevMapHash, HashMap, IterableMap, Map, MapData, MapError, MapInfo};
use aya::programs::ProgramFd;
use gdp_wire::GroupSlot;
use gdp_wire::table::{MAX_COPIES, MAX_GROUPS};

use super::group_slots::{GroupSlots, Member, Step};
use super::pins::PinsError;
use crate::kernel_failures::UpdateError;
use crate::map_update::{removed, update};

/// Number of device maps created at a time.
const TOGETHER: u32 = 16;

/// The name of a device map's pin, without its number.
const PIN: &str = "GROUP-";

pub struct KernelGroups {
    maps: GroupMaps,
    /// The egress program, which every key carries.
    egress: ProgramFd,
    /// Folder in which the device maps are pinned.
    pins: Option<PathBuf>,
    groups: BTreeMap<u32, Group>,
}

/// The maps of the object.
pub struct GroupMaps {
    /// The outer array of device maps.
    pub groups: Map,
    pub served: Array<MapData, u64>,
    pub slots: HashMap<MapData, GroupSlot, u32>,
}

struct Group {
    keys: DevMapHash<MapData>,
    /// `None`: unknown, or the group is unused. The maps may then be written only after a grace
    /// period.
    slots: Option<GroupSlots>,
}

impl KernelGroups {
    /// Opens the groups, including those that an earlier daemon has pinned in the folder.
    pub fn open(maps: GroupMaps, egress: ProgramFd, pins: Option<PathBuf>) -> Result<Self, OpenError> {
        let mut this = Self { maps, egress, pins, groups: BTreeMap::new() };
        let mut occupied: BTreeMap<u32, Vec<(u32, u32, u32)>> = BTreeMap::new();
        for slot in this.maps.slots.iter() {
            let (at, link) = slot?;
            occupied.entry(at.group).or_default().push((at.interface, at.index, link));
        }
        for number in 0..MAX_GROUPS {
            let Some(path) = this.pin(number).filter(|path| path.exists()) else { continue };
            let mut keys = open_pinned(&path)?;
            this.renew(&mut keys)?;
            let found = keys_of(&keys)?;
            let slots = GroupSlots::found(&found, occupied.get(&number).map_or(&[], Vec::as_slice));
            this.groups.insert(number, Group { keys, slots });
        }
        // The earlier daemon may have ended before it inserted all of these maps.
        this.put(&this.groups.keys().copied().collect::<Vec<_>>())?;
        Ok(this)
    }

    /// Returns the groups in use whose slots are known, with their links.
    pub fn found(&self) -> Vec<(u32, Vec<u32>)> {
        let known = self.groups.iter().filter_map(|(number, group)| Some((*number, group.slots.as_ref()?)));
        known.map(|(number, slots)| (number, slots.members().map(|member| member.link).collect())).collect()
    }

    /// Returns the egress interfaces of all groups.
    pub fn interfaces(&self) -> HashSet<u32> {
        let keys = self.groups.values().filter_map(|group| keys_of(&group.keys).ok());
        keys.flatten().map(|(_, interface)| interface).collect()
    }

    /// Sets the links of a group. `members` must be all links to which the egress bits `served`
    /// lead. The kernel does not copy for other bits, for numbers beyond its limits, or after an
    /// error. `wait`: first wait for all frames in flight.
    pub fn set(&mut self, number: u32, members: &[Member], served: u64, wait: bool) -> Result<(), UpdateError> {
        let fits = members.len() <= MAX_COPIES as usize;
        let (members, served) = if fits { (members, served) } else { (&[][..], 0) };
        let is_needed = served != 0 || self.groups.contains_key(&number) || !members.is_empty();
        if number >= MAX_GROUPS || !is_needed {
            return Ok(());
        }
        let made = self.make(number).and_then(|()| if wait { self.put(&[number]) } else { Ok(()) });
        let written = made.and_then(|()| self.write(number, members, served));
        if written.is_err() {
            self.release(number);
            self.serve(number, 0)?;
        }
        written
    }

    /// Marks a group as unused: only frames in flight may still refer to it. Its number may be
    /// reused.
    pub fn release(&mut self, number: u32) {
        if let Some(group) = self.groups.get_mut(&number) {
            group.slots = None;
        }
    }

    /// Stops pinning maps, so that all state ends with this process.
    pub fn unpin(&mut self) {
        self.pins = None;
    }

    fn write(&mut self, number: u32, members: &[Member], served: u64) -> Result<(), UpdateError> {
        const CAPACITY: usize = MAX_COPIES as usize;
        let before = self.maps.served.get(&number, 0).map_err(update("SERVED"))?;
        self.serve(number, before & served)?;
        let Some(group) = self.groups.get_mut(&number) else { return Ok(()) };
        let steps = match group.slots.as_mut().and_then(|slots| slots.become_these(members, CAPACITY)) {
            Some(steps) => steps,
            None => {
                // The userspace plane makes the copies meanwhile.
                self.serve(number, 0)?;
                self.put(&[number])?;
                self.clear(number)?;
                let mut slots = GroupSlots::default();
                let steps = slots.become_these(members, CAPACITY).unwrap_or_default();
                self.groups.entry(number).and_modify(|group| group.slots = Some(slots));
                steps
            }
        };
        steps.iter().try_for_each(|step| self.take(number, step))?;
        self.serve(number, served)
    }

    fn take(&mut self, group: u32, step: &Step) -> Result<(), UpdateError> {
        let Some(keys) = self.groups.get_mut(&group).map(|group| &mut group.keys) else { return Ok(()) };
        let slots = &mut self.maps.slots;
        match *step {
            Step::Occupy { interface, index, link } => {
                slots.insert(GroupSlot { group, interface, index }, link, 0).map_err(update("SLOTS"))
            }
            Step::Vacate { interface, index } => {
                removed(slots.remove(&GroupSlot { group, interface, index })).map_err(update("SLOTS"))
            }
            Step::AddKey { key, interface } => keys
                .insert(key, interface, Some(&self.egress), 0)
                .map_err(|source| UpdateError::Port { port: interface, ifindex: interface, source }),
            // The kernel removes the key itself when the interface is deleted.
            Step::RemoveKey { key } => removed(keys.remove(key)).map_err(update("GROUPS")),
        }
    }

    /// Removes all keys and slots of a group.
    fn clear(&mut self, number: u32) -> Result<(), UpdateError> {
        let slots: Vec<GroupSlot> = self.maps.slots.keys().collect::<Result<_, _>>().map_err(update("SLOTS"))?;
        for slot in slots.iter().filter(|slot| slot.group == number) {
            removed(self.maps.slots.remove(slot)).map_err(update("SLOTS"))?;
        }
        let Some(group) = self.groups.get_mut(&number) else { return Ok(()) };
        for (key, _) in keys_of(&group.keys).map_err(update("GROUPS"))? {
            removed(group.keys.remove(key)).map_err(update("GROUPS"))?;
        }
        Ok(())
    }

    fn serve(&mut self, number: u32, bits: u64) -> Result<(), UpdateError> {
        self.maps.served.set(number, bits, 0).map_err(update("SERVED"))
    }

    /// Creates the device map of the group, unless it exists.
    fn make(&mut self, number: u32) -> Result<(), UpdateError> {
        if self.groups.contains_key(&number) {
            return Ok(());
        }
        let first = number / TOGETHER * TOGETHER;
        let missing: Vec<u32> = (first..first + TOGETHER).filter(|number| !self.groups.contains_key(number)).collect();
        for number in &missing {
            let keys = self.create(*number).map_err(update("GROUPS"))?;
            self.groups.insert(*number, Group { keys, slots: Some(GroupSlots::default()) });
        }
        self.put(&missing)
    }

    fn create(&self, number: u32) -> Result<DevMapHash<MapData>, MapError> {
        const DEVMAP_HASH: u32 = 25;
        let wanted = aya_obj::Map::new_from_params(DEVMAP_HASH, 4, 8, MAX_COPIES, 0);
        let map = MapData::create(wanted, "gdp_group", None)?;
        if let Some(path) = self.pin(number) {
            map.pin(path).map_err(|error| MapError::PinError { name: Some(format!("{PIN}{number}")), error })?;
        }
        DevMapHash::try_from(Map::DevMapHash(map))
    }

    /// Inserts the device maps of these groups into the outer map. Returns after all earlier frames
    /// in flight to a group have left.
    fn put(&mut self, numbers: &[u32]) -> Result<(), UpdateError> {
        let groups = &self.groups;
        let found = || numbers.iter().filter_map(|number| Some((*number, &groups.get(number)?.keys)));
        let Map::ArrayOfMaps(outer) = &self.maps.groups else {
            return Err(update("GROUPS")(MapError::InvalidMapType { map_type: 0 }));
        };
        if found().next().is_none() || put_together(outer, found()).is_ok() {
            return Ok(());
        }
        // Kernels before 5.19 have no batch update for this map.
        let outer = ArrayOfMaps::<_, DevMapHash<MapData>>::try_from(&mut self.maps.groups);
        let mut outer = outer.map_err(update("GROUPS"))?;
        found().try_for_each(|(number, keys)| outer.set(number, keys, 0)).map_err(update("GROUPS"))
    }

    /// Replaces the program in an earlier daemon's keys with this daemon's program. An interface
    /// has at least its number of keys at all times.
    fn renew(&self, keys: &mut DevMapHash<MapData>) -> Result<(), OpenError> {
        let found = keys_of(keys)?;
        let mut spare = (0..MAX_COPIES).find(|key| found.iter().all(|(found, _)| found != key));
        for (key, interface) in found {
            let Some(free) = spare.replace(key) else { break };
            if keys.insert(free, interface, Some(&self.egress), 0).is_err() {
                // The interface has been or is being deleted.
                spare = Some(free);
                continue;
            }
            removed(keys.remove(key))?;
        }
        Ok(())
    }

    fn pin(&self, number: u32) -> Option<PathBuf> {
        self.pins.as_ref().map(|folder| folder.join(format!("{PIN}{number}")))
    }
}

fn open_pinned(path: &Path) -> Result<DevMapHash<MapData>, OpenError> {
    let found = MapInfo::from_pin(path)?.max_entries();
    if found != MAX_COPIES {
        return Err(PinsError::Layout { path: path.into(), what: "capacity", found, wanted: MAX_COPIES }.into());
    }
    Ok(DevMapHash::try_from(Map::DevMapHash(MapData::from_pin(path)?))?)
}

/// Returns the keys of a device map with their interfaces, sorted by key.
fn keys_of(map: &DevMapHash<MapData>) -> Result<Vec<(u32, u32)>, MapError> {
    let mut found = Vec::new();
    for key in map.keys() {
        let key = key?;
        // The kernel has removed a deleted interface.
        found.extend(map.get(key, 0).ok().map(|value| (key, value.if_index)));
    }
    found.sort_unstable();
    Ok(found)
}

/// Updates several elements of the outer map in one call, which waits for only one grace period.
/// aya has no such call.
fn put_together<'a>(outer: &MapData, elements: impl Iterator<Item = (u32, &'a DevMapHash<MapData>)>) -> io::Result<()> {
    const BPF_MAP_UPDATE_BATCH: libc::c_long = 26;
    /// The part of `union bpf_attr` (linux/bpf.h) that this call uses.
    #[repr(C)]
    struct Batch {
        in_batch: u64,
        out_batch: u64,
        keys: u64,
        values: u64,
        count: u32,
        map_fd: u32,
        elem_flags: u64,
        flags: u64,
    }
    let of = |map: &MapData| map.fd().as_fd().as_raw_fd() as u32;
    let (keys, values): (Vec<u32>, Vec<u32>) = elements.map(|(key, map)| (key, of(map.map()))).unzip();
    let batch = Batch {
        in_batch: 0,
        out_batch: 0,
        keys: keys.as_ptr() as u64,
        values: values.as_ptr() as u64,
        count: keys.len() as u32,
        map_fd: of(outer),
        elem_flags: 0,
        flags: 0,
    };
    // SAFETY: the structure, and the keys and values it points to, outlive the call and have the
    // stated lengths. The descriptors are open.
    let result = unsafe { libc::syscall(libc::SYS_bpf, BPF_MAP_UPDATE_BATCH, &raw const batch, size_of::<Batch>()) };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}
