//! The route of a name from the control plane, and the resulting entry and permits in the planes.

use gdp_wire::{FibEntry, Name, Permit};

use crate::tables::RouteEntry;

/// Route of a name from this switch, as links.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PlaneRoute {
    /// Egress switches that need a copy. Includes this switch's own bit if there are local readers.
    pub egress_bits: u64,
    /// Links of the local readers, sorted, without duplicates.
    pub readers: Vec<u32>,
    /// Links to local endpoints and into other domains on which frames to the name may arrive.
    /// Sorted, without duplicates; or [`gdp_wire::table::ANY_WRITER`] alone.
    pub writers: Vec<u32>,
    /// Links into other domains on which frames from the name may arrive, sorted, without
    /// duplicates.
    pub sources: Vec<u32>,
}

impl PlaneRoute {
    /// Returns whether the data plane can omit this route. Frames to the name then have no
    /// destination, and no other domain may send frames from it.
    pub fn is_idle(&self) -> bool {
        self.egress_bits == 0 && self.readers.is_empty() && self.sources.is_empty()
    }

    /// Returns the data planes' entry and permits of the route. `group`: the group of its readers.
    pub(crate) fn entry(&self, name: &Name, group: u32) -> RouteEntry {
        let (writer_link, others) = self.writers.split_first().unwrap_or((&0, &[]));
        let entry = FibEntry {
            egress_bits: self.egress_bits,
            local_link: if let [link] = self.readers[..] { link } else { 0 },
            group,
            writer_link: *writer_link,
            egress_set: 0,
            more_writers: u8::from(!others.is_empty()),
            reserved: 0,
        };
        let writers = others.iter().map(|link| Permit { name: *name, link: *link, part: Permit::DESTINATION });
        (entry, writers.chain(self.source_permits(name)).collect())
    }

    /// Returns the permits for frames from the name on its links into other domains.
    pub(crate) fn source_permits(&self, name: &Name) -> impl Iterator<Item = Permit> {
        let name = *name;
        self.sources.iter().map(move |link| Permit { name, link: *link, part: Permit::SOURCE })
    }
}
