//! Assigns the links of a multicast group to slots of the kernel's map. The order of changes
//! ensures that no other link of the group misses a frame or receives a duplicate.
//! `gdp-ebpf/src/groups.rs` defines the rules. Sans-IO; [`super::kernel_groups`] calls it.

use std::collections::{BTreeMap, BTreeSet};

/// A link that receives copies, and its egress interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Member {
    pub link: u32,
    pub interface: u32,
}

/// The slots of a group.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct GroupSlots {
    by_interface: BTreeMap<u32, Vec<Slot>>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Slot {
    /// Key in the device map. The keys of one interface are interchangeable between its slots.
    key: u32,
    /// Link id; 0 for an empty slot.
    link: u32,
}

/// One write to the kernel's maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    Occupy { interface: u32, index: u32, link: u32 },
    Vacate { interface: u32, index: u32 },
    AddKey { key: u32, interface: u32 },
    RemoveKey { key: u32 },
}

impl GroupSlots {
    /// Builds the slots from the maps: (key, interface) and (interface, index, link). Returns
    /// `None` if a slot has no key, for example because a daemon ended between two steps.
    pub fn found(keys: &[(u32, u32)], occupied: &[(u32, u32, u32)]) -> Option<Self> {
        let mut slots = Self::default();
        for (key, interface) in keys {
            slots.by_interface.entry(*interface).or_default().push(Slot { key: *key, link: 0 });
        }
        for (interface, index, link) in occupied {
            slots.by_interface.get_mut(interface)?.get_mut(*index as usize)?.link = *link;
        }
        Some(slots)
    }

    pub fn members(&self) -> impl Iterator<Item = Member> {
        let slots = self.by_interface.iter().flat_map(|(interface, slots)| slots.iter().map(|p| (*interface, p)));
        slots.filter(|(_, slot)| slot.link != 0).map(|(interface, slot)| Member { link: slot.link, interface })
    }

    /// Makes `wanted` the members and returns the steps. Returns `None` without changes if this
    /// needs more than `capacity` keys, including the keys of empty slots.
    pub fn become_these(&mut self, wanted: &[Member], capacity: usize) -> Option<Vec<Step>> {
        let (wanted, before): (BTreeSet<_>, BTreeSet<_>) = (wanted.iter().copied().collect(), self.members().collect());
        let mut after = self.clone();
        let mut steps = Vec::new();
        before.difference(&wanted).for_each(|member| after.leave(*member, &mut steps));
        for member in wanted.difference(&before) {
            after.join(*member, capacity, &mut steps)?;
        }
        *self = after;
        Some(steps)
    }

    fn leave(&mut self, member: Member, steps: &mut Vec<Step>) {
        let interface = member.interface;
        let Some(slots) = self.by_interface.get_mut(&interface) else { return };
        let Some(index) = slots.iter().position(|slot| slot.link == member.link) else { return };
        slots[index].link = 0;
        steps.push(Step::Vacate { interface, index: index as u32 });
        while let Some(last) = slots.pop_if(|last| last.link == 0) {
            steps.push(Step::RemoveKey { key: last.key });
        }
        if slots.is_empty() {
            self.by_interface.remove(&interface);
        }
    }

    fn join(&mut self, Member { link, interface }: Member, capacity: usize, steps: &mut Vec<Step>) -> Option<()> {
        let free = self.free_key(capacity);
        let slots = self.by_interface.entry(interface).or_default();
        if let Some(index) = slots.iter().position(|slot| slot.link == 0) {
            slots[index].link = link;
            steps.push(Step::Occupy { interface, index: index as u32, link });
            return Some(());
        }
        let (index, key) = (slots.len() as u32, free?);
        slots.push(Slot { key, link });
        steps.extend([Step::Occupy { interface, index, link }, Step::AddKey { key, interface }]);
        Some(())
    }

    fn free_key(&self, capacity: usize) -> Option<u32> {
        let used: BTreeSet<u32> = self.by_interface.values().flatten().map(|slot| slot.key).collect();
        (0..capacity as u32).find(|key| !used.contains(key))
    }
}

#[cfg(test)]
#[path = "../tests/unit/group_slots.rs"]
mod tests;
