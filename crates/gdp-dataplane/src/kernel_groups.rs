//! The groups of links that the kernel copies frames to: writes the maps of
//! `gdp-ebpf/src/groups.rs` by its rules. Knows nothing of names, nor whether a link belongs in a
//! group. Called by [`super::kernel`].
//!
//! The device map of a group is made when the group is first needed and then kept, because to put
//! one into the outer map takes an RCU grace period (8 ms); several are made at a time, for the
//! price of one. Where maps are pinned, each of them is, too: to open it from the outer map would
//! take CAP_SYS_ADMIN.

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

/// Device maps made at a time.
const TOGETHER: u32 = 16;

/// The name of a device map's pin, without its number.
const PIN: &str = "GROUP-";

pub struct KernelGroups {
    maps: GroupMaps,
    /// Of what leaves; each key has it.
    egress: ProgramFd,
    /// The folder that the device maps are pinned in.
    pins: Option<PathBuf>,
    groups: BTreeMap<u32, Group>,
}

/// The maps of the object.
pub struct GroupMaps {
    /// An array of maps.
    pub groups: Map,
    pub served: Array<MapData, u64>,
    pub slots: HashMap<MapData, GroupSlot, u32>,
}

struct Group {
    keys: DevMapHash<MapData>,
    /// `None`: not known, or nobody's any more. Then it may be written only after a grace period.
    slots: Option<GroupSlots>,
}

impl KernelGroups {
    /// With what an earlier daemon has pinned in the folder.
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
        // Which of them the earlier daemon had come to put there is not known.
        this.put(&this.groups.keys().copied().collect::<Vec<_>>())?;
        Ok(this)
    }

    /// The groups that are in use, as far as known, with the links in them.
    pub fn found(&self) -> Vec<(u32, Vec<u32>)> {
        let known = self.groups.iter().filter_map(|(number, group)| Some((*number, group.slots.as_ref()?)));
        known.map(|(number, slots)| (number, slots.members().map(|member| member.link).collect())).collect()
    }

    /// The interfaces that frames for groups leave by.
    pub fn interfaces(&self) -> HashSet<u32> {
        let keys = self.groups.values().filter_map(|group| keys_of(&group.keys).ok());
        keys.flatten().map(|(_, interface)| interface).collect()
    }

    /// Makes `members` the links of a group, which are all that the egress bits `served` lead to:
    /// for others the kernel does not copy, nor if the numbers are beyond what it holds, nor after
    /// an error. `wait`: until every frame is gone that is under way.
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

    /// Nothing leads to the group any more, but for frames that are under way. Its number may be
    /// used again.
    pub fn release(&mut self, number: u32) {
        if let Some(group) = self.groups.get_mut(&number) {
            group.slots = None;
        }
    }

    /// From now on everything ends with this process.
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
                slots.insert(GroupSlot { group, interface, index }, link, 0).map_err(update("PLACES"))
            }
            Step::Vacate { interface, index } => {
                removed(slots.remove(&GroupSlot { group, interface, index })).map_err(update("PLACES"))
            }
            Step::AddKey { key, interface } => keys
                .insert(key, interface, Some(&self.egress), 0)
                .map_err(|source| UpdateError::Port { port: interface, ifindex: interface, source }),
            // The kernel takes out an interface that is deleted.
            Step::RemoveKey { key } => removed(keys.remove(key)).map_err(update("GROUPS")),
        }
    }

    /// Removes all keys and slots of a group.
    fn clear(&mut self, number: u32) -> Result<(), UpdateError> {
        let slots: Vec<GroupSlot> = self.maps.slots.keys().collect::<Result<_, _>>().map_err(update("PLACES"))?;
        for slot in slots.iter().filter(|slot| slot.group == number) {
            removed(self.maps.slots.remove(slot)).map_err(update("PLACES"))?;
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

    /// Sees to it that there is a device map for the group.
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

    /// Puts the device maps of these groups into the outer map, and waits until every frame is gone
    /// that was under way to a group before.
    fn put(&mut self, numbers: &[u32]) -> Result<(), UpdateError> {
        let groups = &self.groups;
        let found = || numbers.iter().filter_map(|number| Some((*number, &groups.get(number)?.keys)));
        let Map::ArrayOfMaps(outer) = &self.maps.groups else {
            return Err(update("GROUPS")(MapError::InvalidMapType { map_type: 0 }));
        };
        if found().next().is_none() || put_together(outer, found()).is_ok() {
            return Ok(());
        }
        // Kernels before 5.19 take only one at a time.
        let outer = ArrayOfMaps::<_, DevMapHash<MapData>>::try_from(&mut self.maps.groups);
        let mut outer = outer.map_err(update("GROUPS"))?;
        found().try_for_each(|(number, keys)| outer.set(number, keys, 0)).map_err(update("GROUPS"))
    }

    /// Gives an earlier daemon's keys the program of this one, without a moment in which an
    /// interface has a key too few.
    fn renew(&self, keys: &mut DevMapHash<MapData>) -> Result<(), OpenError> {
        let found = keys_of(keys)?;
        let mut spare = (0..MAX_COPIES).find(|key| found.iter().all(|(found, _)| found != key));
        for (key, interface) in found {
            let Some(free) = spare.replace(key) else { break };
            if keys.insert(free, interface, Some(&self.egress), 0).is_err() {
                // The interface is gone, or just going.
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

/// The keys of a device map with their interfaces, in the order of the keys.
fn keys_of(map: &DevMapHash<MapData>) -> Result<Vec<(u32, u32)>, MapError> {
    let mut found = Vec::new();
    for key in map.keys() {
        let key = key?;
        // The kernel takes out an interface that is deleted.
        found.extend(map.get(key, 0).ok().map(|value| (key, value.if_index)));
    }
    found.sort_unstable();
    Ok(found)
}

/// Several elements of the outer map in one call, which waits for one grace period only. aya has no
/// such call.
fn put_together<'a>(outer: &MapData, elements: impl Iterator<Item = (u32, &'a DevMapHash<MapData>)>) -> io::Result<()> {
    const BPF_MAP_UPDATE_BATCH: libc::c_long = 26;
    /// The part of `union bpf_attr` (linux/bpf.h) that the call takes.
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
    // SAFETY: the structure, and the keys and values it points to, live as long as the call and are
    // as long as it says; the descriptors are open.
    let result = unsafe { libc::syscall(libc::SYS_bpf, BPF_MAP_UPDATE_BATCH, &raw const batch, size_of::<Batch>()) };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}
