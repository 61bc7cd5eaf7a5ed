//! Which group of links takes the copies of a name: names with the same local readers share one.
//! Sans-IO; the numbers are [`gdp_wire::FibEntry::group`]. Called by [`crate::Planes`].

use std::collections::{BTreeSet, HashMap};

use gdp_wire::table::NEIGHBOURS;

/// The groups in use.
#[derive(Default)]
pub struct Groups {
    by_readers: HashMap<Box<[u32]>, u32>,
    used: HashMap<u32, Group>,
    /// Whether a name without local readers leads to several neighbours.
    neighbours_fork: bool,
    /// Below the highest number that was used.
    free: BTreeSet<u32>,
    highest: u32,
}

struct Group {
    readers: Box<[u32]>,
    names: usize,
    /// Whether one of its names, by its egress bits, leads to several links from here.
    forks: bool,
}

impl Groups {
    /// The group of these readers, for one more name; and whether it is new. `readers`: link ids,
    /// sorted, without duplicates. The lowest free number is taken first: the kernel holds only so
    /// many groups.
    pub fn take(&mut self, readers: &[u32]) -> (u32, bool) {
        self.take_as(readers, None)
    }

    /// As [`Self::take`]; if the group is new, with a number that it had before, unless another has
    /// that now.
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

    /// One name less; `true` if it was the last of its group, which is then free.
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

    /// From now on, until its last name goes, the group has a name that leads to several links from
    /// here; `true` if it had none.
    pub fn fork(&mut self, number: u32) -> bool {
        let forks = match self.used.get_mut(&number) {
            Some(group) => &mut group.forks,
            None if number == NEIGHBOURS => &mut self.neighbours_fork,
            None => return false,
        };
        !std::mem::replace(forks, true)
    }

    /// Whether frames for the group can need copies, where so many links lead to switches. A frame
    /// from a neighbour can be for all the other links, whatever the routes here say; one from an
    /// endpoint is for those that its name's route says.
    pub fn makes_copies(&self, number: u32, neighbours: usize) -> bool {
        let (readers, forks) = match self.used.get(&number) {
            Some(group) => (group.readers.len(), group.forks),
            None => (0, number == NEIGHBOURS && self.neighbours_fork),
        };
        forks || neighbours + readers > 2 && neighbours > 0
    }

    /// The local readers of a group.
    pub fn readers(&self, number: u32) -> &[u32] {
        self.used.get(&number).map_or(&[], |group| &group.readers)
    }

    /// All groups in use, with their local readers.
    pub fn iter(&self) -> impl Iterator<Item = (u32, &[u32])> {
        self.used.iter().map(|(number, group)| (*number, &*group.readers))
    }
}

#[cfg(test)]
#[path = "../tests/unit/groups.rs"]
mod tests;
