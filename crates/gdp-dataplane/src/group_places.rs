//! Which place in a group of the kernel each link has, and what to change, in which order, so that nobody else in the group
//! misses a frame or gets one twice meanwhile. The rules are those of `gdp-ebpf/src/groups.rs`. Sans-IO; called by
//! [`super::kernel_groups`].

use std::collections::{BTreeMap, BTreeSet};

/// A link that takes copies, and the interface they leave by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Member {
    pub link: u32,
    pub interface: u32,
}

/// The places of a group.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Places {
    by_interface: BTreeMap<u32, Vec<Place>>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Place {
    /// In the device map; which of an interface's keys belongs to which of its places does not matter.
    key: u32,
    /// 0: empty.
    link: u32,
}

/// One write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    Occupy { interface: u32, index: u32, link: u32 },
    Vacate { interface: u32, index: u32 },
    AddKey { key: u32, interface: u32 },
    RemoveKey { key: u32 },
}

impl Places {
    /// What is found in the maps: (key, interface) and (interface, index, link). `None` if a place has no key, as when a
    /// daemon ended between two steps.
    pub fn found(keys: &[(u32, u32)], occupied: &[(u32, u32, u32)]) -> Option<Self> {
        let mut places = Self::default();
        for (key, interface) in keys {
            places.by_interface.entry(*interface).or_default().push(Place { key: *key, link: 0 });
        }
        for (interface, index, link) in occupied {
            places.by_interface.get_mut(interface)?.get_mut(*index as usize)?.link = *link;
        }
        Some(places)
    }

    pub fn members(&self) -> impl Iterator<Item = Member> {
        let places = self.by_interface.iter().flat_map(|(interface, places)| places.iter().map(|p| (*interface, p)));
        places.filter(|(_, place)| place.link != 0).map(|(interface, place)| Member { link: place.link, interface })
    }

    /// Makes `wanted` the members. `None`, and no change, if that takes more than `capacity` keys, those of empty places included.
    pub fn become_these(&mut self, wanted: &[Member], capacity: usize) -> Option<Vec<Step>> {
        let (wanted, held): (BTreeSet<_>, BTreeSet<_>) = (wanted.iter().copied().collect(), self.members().collect());
        let mut after = self.clone();
        let mut steps = Vec::new();
        held.difference(&wanted).for_each(|member| after.leave(*member, &mut steps));
        for member in wanted.difference(&held) {
            after.join(*member, capacity, &mut steps)?;
        }
        *self = after;
        Some(steps)
    }

    fn leave(&mut self, member: Member, steps: &mut Vec<Step>) {
        let interface = member.interface;
        let Some(places) = self.by_interface.get_mut(&interface) else { return };
        let Some(index) = places.iter().position(|place| place.link == member.link) else { return };
        places[index].link = 0;
        steps.push(Step::Vacate { interface, index: index as u32 });
        while let Some(last) = places.pop_if(|last| last.link == 0) {
            steps.push(Step::RemoveKey { key: last.key });
        }
        if places.is_empty() {
            self.by_interface.remove(&interface);
        }
    }

    fn join(&mut self, Member { link, interface }: Member, capacity: usize, steps: &mut Vec<Step>) -> Option<()> {
        let free = self.free_key(capacity);
        let places = self.by_interface.entry(interface).or_default();
        if let Some(index) = places.iter().position(|place| place.link == 0) {
            places[index].link = link;
            steps.push(Step::Occupy { interface, index: index as u32, link });
            return Some(());
        }
        let (index, key) = (places.len() as u32, free?);
        places.push(Place { key, link });
        steps.extend([Step::Occupy { interface, index, link }, Step::AddKey { key, interface }]);
        Some(())
    }

    fn free_key(&self, capacity: usize) -> Option<u32> {
        let used: BTreeSet<u32> = self.by_interface.values().flatten().map(|place| place.key).collect();
        (0..capacity as u32).find(|key| !used.contains(key))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_link_keeps_its_place_while_others_come_and_go() {
        let member = |link, interface| Member { link, interface };
        let mut places = Places::default();
        let steps = places.become_these(&[member(10, 3), member(11, 3), member(12, 3), member(20, 4)], 8).unwrap();
        assert_eq!(steps.len(), 8);
        assert_eq!(
            steps[..2],
            [Step::Occupy { interface: 3, index: 0, link: 10 }, Step::AddKey { key: 0, interface: 3 }]
        );
        let steps = places.become_these(&[member(12, 3), member(20, 4)], 8).unwrap();
        assert_eq!(steps, [Step::Vacate { interface: 3, index: 0 }, Step::Vacate { interface: 3, index: 1 }]);
        let steps = places.become_these(&[member(12, 3), member(13, 3), member(20, 4)], 8).unwrap();
        assert_eq!(steps, [Step::Occupy { interface: 3, index: 0, link: 13 }]);
        let steps = places.become_these(&[member(13, 3), member(20, 4)], 8).unwrap();
        assert_eq!(
            steps,
            [Step::Vacate { interface: 3, index: 2 }, Step::RemoveKey { key: 2 }, Step::RemoveKey { key: 1 }]
        );
        assert_eq!(places.become_these(&[], 8).unwrap().len(), 4);
        assert_eq!(places, Places::default());
    }

    #[test]
    fn empty_places_take_room() {
        let many = |range: std::ops::Range<u32>| range.map(|link| Member { link, interface: 3 }).collect::<Vec<_>>();
        let mut places = Places::default();
        assert!(places.become_these(&many(1..6), 4).is_none());
        places.become_these(&many(1..5), 4).unwrap();
        places.become_these(&many(4..5), 4).unwrap();
        let before = places.clone();
        assert!(places.become_these(&[&many(4..5)[..], &[Member { link: 9, interface: 5 }]].concat(), 4).is_none());
        assert_eq!(places, before);
    }

    #[test]
    fn what_is_found_is_the_same_group() {
        let mut places = Places::default();
        let members = [(10, 3), (11, 3), (20, 4)].map(|(link, interface)| Member { link, interface });
        places.become_these(&members, 8).unwrap();
        let mut found = Places::found(&[(0, 3), (1, 3), (2, 4)], &[(3, 0, 10), (4, 0, 20), (3, 1, 11)]).unwrap();
        assert_eq!(found, places);
        assert_eq!(found.become_these(&members, 8), Some(vec![]));
        assert_eq!(Places::found(&[(0, 3)], &[(3, 0, 10), (3, 1, 11)]), None, "a place without a key");
    }
}
