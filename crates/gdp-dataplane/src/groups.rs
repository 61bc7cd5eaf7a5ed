//! Assigns names to groups of links for copies: names with the same local readers share a group.
//! Sans-IO. Group numbers are [`gdp_wire::FibEntry::group`]. [`crate::Planes`] calls this module.

use std::collections::{BTreeSet, HashMap};

use gdp_wire::table::NEIGHBOURS;

/// The groups in use.
#[derive(Default)]
pub struct Groups {
    by_readers: HashMap<Box<[u32]>, u32>,
    used: HashMap<u32, Group>,
    /// Whether a name without local readers leads to several neighbours.
    neighbours_fork: bool,
    /// Free numbers below the highest number used.
    free: BTreeSet<u32>,
    highest: u32,
}

struct Group {
    readers: Box<[u32]>,
    names: usize,
    /// Whether the egress bits of any of its names lead to several links from here.
    forks: bool,
}

impl Groups {
    /// Adds one name to the group of these readers. Returns the group number and whether the group
    /// is new. `readers`: link ids, sorted, without duplicates. A new group gets the lowest free
    /// number, because the kernel supports a limited number of groups.
    pub fn take(&mut self, readers: &[u32]) -> (u32, bool) {
        self.take_as(readers, None)
    }

    /// Adds a name as [`Self::take`] does. A new group gets `number`, its previous number, unless
    /// another group has that number now.
    pub fn take_as(&mut self, readers: &[u32], number: Option<u32>) -> (u32, bool) {
        if readers.is_empty() {
            return (NEIGHBOURS, false);
        }
        if let Some(number) = self.by_readers.get(readers) {
            if let Some(group) = self.used.get_mut(number) {
                group.names += 1;
            }
            return (*number, false);
        }
        let wanted = number.filter(|number| *number != NEIGHBOURS && !self.used.contains_key(number));
        let number = wanted.or_else(|| self.free.first().copied()).unwrap_or(self.highest + 1);
        self.free.extend(self.highest + 1..number);
        self.free.remove(&number);
        self.highest = self.highest.max(number);
        self.by_readers.insert(readers.into(), number);
        self.used.insert(number, Group { readers: readers.into(), names: 1, forks: false });
        (number, true)
    }

    /// Removes one name. Returns `true` if it was the group's last name; the group is then free.
    pub fn release(&mut self, number: u32) -> bool {
        let Some(group) = self.used.get_mut(&number) else { return false };
        group.names -= 1;
        if group.names > 0 {
            return false;
        }
        if let Some(group) = self.used.remove(&number) {
            self.by_readers.remove(&group.readers);
        }
        self.free.insert(number);
        true
    }

    /// Records that a name of the group leads to several links from here, until the group is freed.
    /// Returns `true` if this is new.
    pub fn fork(&mut self, number: u32) -> bool {
        let forks = match self.used.get_mut(&number) {
            Some(group) => &mut group.forks,
            None if number == NEIGHBOURS => &mut self.neighbours_fork,
            None => return false,
        };
        !std::mem::replace(forks, true)
    }

    /// Returns whether frames to the group can need copies, given this many links to switches. A
    /// frame from a neighbour can be for all other links, regardless of local routes. A frame from
    /// an endpoint is for the links of its name's route.
    pub fn makes_copies(&self, number: u32, neighbours: usize) -> bool {
        let (readers, forks) = match self.used.get(&number) {
            Some(group) => (group.readers.len(), group.forks),
            None => (0, number == NEIGHBOURS && self.neighbours_fork),
        };
        forks || neighbours + readers > 2 && neighbours > 0
    }

    /// Returns the local readers of a group.
    pub fn readers(&self, number: u32) -> &[u32] {
        self.used.get(&number).map_or(&[], |group| &group.readers)
    }

    /// Returns all groups in use, with their local readers.
    pub fn iter(&self) -> impl Iterator<Item = (u32, &[u32])> {
        self.used.iter().map(|(number, group)| (*number, &*group.readers))
    }
}

#[cfg(test)]
#[path = "../tests/unit/groups.rs"]
mod tests;
