//! Applies links, routes and groups to each plane. It compares the desired state with the planes'
//! state and passes on the differences. If one plane refuses a change, it reverts the change in
//! all.

use gdp_link::port::LinkAddr;
use gdp_wire::table::{NEIGHBOURS, PORT_ROUTED, PORT_USERSPACE};
use gdp_wire::{LinkEntry, LinkRole, Name};

use crate::data_plane::{DataPlane, FastPath};
use crate::groups::Groups;
use crate::kernel_failures::UpdateError;
use crate::route::PlaneRoute;
use crate::userspace_plane::UserspacePlane;

pub struct Dispatcher {
    pub userspace: UserspacePlane,
    /// The fast path, or the reason why there is none.
    pub fast_path: Result<Box<dyn FastPath>, String>,
    pub groups: Groups,
    pub own_bit: u64,
    fib_capacity: u32,
}

impl Dispatcher {
    /// Creates a dispatcher. `fib_capacity`: maximum number of names in the FIB.
    pub fn new(userspace: UserspacePlane, fast_path: Result<Box<dyn FastPath>, String>, fib_capacity: u32) -> Self {
        Self { userspace, fast_path, groups: Groups::default(), own_bit: 0, fib_capacity }
    }

    pub fn each(&self) -> impl Iterator<Item = &dyn DataPlane> {
        let fast_path = self.fast_path.iter().map(|fast_path| &**fast_path as &dyn DataPlane);
        std::iter::once(&self.userspace as &dyn DataPlane).chain(fast_path)
    }

    /// Changes the userspace plane, then the fast path.
    pub fn on_each(
        &mut self,
        change: impl Fn(&mut dyn DataPlane) -> Result<(), UpdateError>,
    ) -> Result<(), UpdateError> {
        change(&mut self.userspace)?;
        self.on_fast_path(|fast_path| change(fast_path))
    }

    pub fn on_fast_path(
        &mut self,
        change: impl FnOnce(&mut dyn FastPath) -> Result<(), UpdateError>,
    ) -> Result<(), UpdateError> {
        self.fast_path.as_mut().map_or(Ok(()), |fast_path| change(&mut **fast_path))
    }

    /// Returns the port by which the fast path can send on a link, or [`PORT_USERSPACE`]. `device`:
    /// egress device of an Ethernet link.
    pub fn port_for(&self, entry: &LinkEntry, device: Option<u32>) -> u32 {
        let port = self.fast_path.as_ref().ok().and_then(|fast_path| fast_path.egress_port(entry, device));
        port.unwrap_or(PORT_USERSPACE)
    }

    /// Adds or replaces a link. This function sets `entry.port`. `device`: see [`Self::port_for`].
    pub fn set_link(&mut self, mut entry: LinkEntry, to: LinkAddr, device: Option<u32>) -> Result<(), UpdateError> {
        if let Ok(fast_path) = &mut self.fast_path {
            fast_path.resolve(&entry);
        }
        entry.port = self.port_for(&entry, device);
        let before = self.userspace.tables.at_index_of(entry.id).copied();
        if self.userspace.tables.link(entry.id).is_none() {
            self.on_each(|plane| plane.begin_link(entry.id))?;
        }
        self.on_each(|plane| plane.set_link(&entry, to))?;
        let is_rerouted = self.fast_path.as_mut().is_ok_and(|fast_path| fast_path.follow_route(&entry));
        let of_groups = |link: &LinkEntry| (link.id, link.role, link.port, link.reach);
        if is_rerouted || before.as_ref().map(of_groups) != Some(of_groups(&entry)) {
            self.set_groups_of(before.as_slice());
            self.set_groups_of(&[entry]);
        }
        Ok(())
    }

    /// Removes a link. An unknown link is no error.
    pub fn remove_link(&mut self, id: u32) -> Result<(), UpdateError> {
        let Some(removed) = self.userspace.tables.link(id).copied() else { return Ok(()) };
        self.userspace.remove_link(id)?;
        self.set_groups_of(&[removed]);
        self.on_fast_path(|fast_path| fast_path.remove_link(id))
    }

    /// Looks up the egress interfaces of links over UDP again. The fast path then copies again for
    /// groups that it left to the userspace plane because such a route had changed.
    pub fn follow_routes(&mut self) {
        let Ok(fast_path) = &mut self.fast_path else { return };
        let links = self.userspace.tables.links().map(|(entry, _)| **entry);
        let routed: Vec<LinkEntry> = links.filter(|entry| entry.port == PORT_ROUTED).collect();
        routed.iter().for_each(|link| _ = fast_path.follow_route(link));
        self.set_groups_of(&routed);
    }

    /// Adds or replaces the route of a name. After an error nothing has changed. `number`: the
    /// group number to reuse if the group of these readers is new here.
    pub fn set_route(&mut self, name: Name, route: &PlaneRoute, number: Option<u32>) -> Result<(), UpdateError> {
        if !self.userspace.tables.has_room_for(&name) {
            return Err(UpdateError::FibFull { capacity: self.fib_capacity });
        }
        let (group, is_new) = self.groups.take_as(&route.readers, number);
        if is_new {
            self.userspace.set_group(group, &route.readers, None);
        }
        let beyond = (route.egress_bits & !self.own_bit).count_ones() as usize;
        let forks = beyond + route.readers.len() > 1 && self.groups.fork(group);
        if is_new || forks {
            self.set_group(group);
        }
        let before = self.userspace.tables.route_entry(&name);
        let entry = route.entry(&name, group);
        let set = self.on_each(|plane| plane.set_route(&name, &entry, before.as_ref()));
        if set.is_err() {
            // Restoring the previous route never exceeds the table's capacity.
            let _ = match &before {
                Some(before) => self.userspace.set_route(&name, before, None),
                None => self.userspace.remove_route(&name, &[]),
            };
        }
        let released = if set.is_ok() { before.map(|(before, _)| before.group) } else { Some(group) };
        released.into_iter().for_each(|group| self.release_group(group));
        set
    }

    /// Removes a route. An unknown name is no error.
    pub fn remove_route(&mut self, name: &Name) -> Result<(), UpdateError> {
        let before = self.userspace.tables.route_entry(name);
        let permits = before.as_ref().map_or(&[][..], |(_, permits)| permits);
        let removed = self.on_fast_path(|fast_path| fast_path.remove_route(name, permits));
        self.userspace.remove_route(name, permits)?;
        before.into_iter().for_each(|(before, _)| self.release_group(before.group));
        removed
    }

    /// Releases one name's reference to a group.
    fn release_group(&mut self, group: u32) {
        if self.groups.release(group) {
            self.userspace.release_group(group);
            self.fast_path.iter_mut().for_each(|fast_path| fast_path.release_group(group));
        }
    }

    pub fn set_own_bit(&mut self, own_bit: u64) -> Result<(), UpdateError> {
        self.own_bit = own_bit;
        self.on_each(|plane| plane.set_own_bit(own_bit))?;
        self.set_all_groups();
        Ok(())
    }

    pub fn set_all_groups(&mut self) {
        let groups: Vec<u32> = self.groups.iter().map(|(group, _)| group).collect();
        groups.into_iter().chain([NEIGHBOURS]).for_each(|group| self.set_group(group));
    }

    /// Updates the groups that contain or contained these links.
    fn set_groups_of(&mut self, links: &[LinkEntry]) {
        if links.iter().any(|link| link.role == LinkRole::Switch as u32) {
            return self.set_all_groups();
        }
        let has_one = |readers: &[u32]| links.iter().any(|link| readers.binary_search(&link.id).is_ok());
        let groups = self.groups.iter().filter(|(_, readers)| has_one(readers)).map(|(group, _)| group);
        groups.collect::<Vec<_>>().into_iter().for_each(|group| self.set_group(group));
    }

    /// Makes the fast path copy frames to the links of a group, if the group needs copies.
    pub fn set_group(&mut self, group: u32) {
        let Ok(fast_path) = &mut self.fast_path else { return };
        let tables = &self.userspace.tables;
        let links: Vec<&LinkEntry> = tables.members(group).into_iter().filter_map(|id| tables.link(id)).collect();
        let neighbours = links.iter().filter(|link| link.role == LinkRole::Switch as u32).count();
        let copies = self.groups.makes_copies(group, neighbours).then_some(&links[..]);
        fast_path.set_group(group, self.groups.readers(group), copies);
    }
}
