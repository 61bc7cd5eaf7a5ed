//! Where a name leads, as the control plane states it, and the entry and permits that the planes
//! hold of it.

use gdp_wire::{FibEntry, Name, Permit};

use crate::tables::RouteEntry;

/// Where a name leads from this switch, in links.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PlaneRoute {
    /// Egress switches that want a copy, this one's own bit included if there are readers here.
    pub egress_bits: u64,
    /// Links of the local readers, sorted, without duplicates.
    pub readers: Vec<u32>,
    /// Links of the local endpoints, and into other domains, on which frames to the name may come,
    /// sorted, without duplicates; or [`gdp_wire::table::ANY_WRITER`] alone.
    pub writers: Vec<u32>,
    /// Links into other domains on which frames from the name may come, sorted, without duplicates.
    pub sources: Vec<u32>,
}

impl PlaneRoute {
    /// Whether frames to the name go nowhere, and none from it come from abroad: then the data
    /// plane need not hold it.
    pub fn is_idle(&self) -> bool {
        self.egress_bits == 0 && self.readers.is_empty() && self.sources.is_empty()
    }

    /// What the data planes hold of it. `group`: of its readers.
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

    /// What lets frames from the name come by its links into other domains.
    pub(crate) fn source_permits(&self, name: &Name) -> impl Iterator<Item = Permit> {
        let name = *name;
        self.sources.iter().map(move |link| Permit { name, link: *link, part: Permit::SOURCE })
    }
}
