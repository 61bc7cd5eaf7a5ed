//! Parts that entities of other domains have in names, as the RIBs of those domains tell: taken in here, and put to those that ask
//! what is to be told on. Which borders they are reached by is [`super::ways`]' matter.

use std::collections::{BTreeMap, BTreeSet};

use gdp::cert::Signed;
use gdp::control::{Record, RecordPlace, Refusal};
use gdp::keys::KeyBox;
use gdp_wire::Name;

use super::{Now, Rib};

/// A part that an entity of another domain has in a name, as that domain's RIB told, or one between.
#[derive(Clone, Debug)]
pub struct Foreign {
    pub record: Record,
    /// Of which the record's switch is a member; the caller has verified that.
    pub domain: Name,
    /// The neighbouring domain it came from: the next on the way to `domain`, where that has no border with this one.
    pub next: Name,
    /// Domains it has passed, its own included: 1 if it came from its own.
    pub hops: u32,
    /// Of what the entity sends to the name, and to those it meets there, for whom this RIB knows.
    pub boxes: Vec<Signed<KeyBox>>,
    /// Entities of this domain may know it; otherwise it is only told on to other domains.
    pub local: bool,
}

/// A link of a border switch into another domain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Way {
    /// This domain's switch.
    pub border: Name,
    /// The switch at the other end.
    pub peer: Name,
    pub cost: u32,
}

/// What another RIB may be told of one registration.
#[derive(Clone, Debug)]
pub struct Export {
    pub record: Record,
    /// The keys of what the entity sends, for those in other domains that take it.
    pub boxes: Vec<Signed<KeyBox>>,
    /// Where it came from: its domain, and the neighbour that told of it; none: it is registered here.
    pub origin: Option<(Name, Name)>,
}

impl Rib {
    /// Takes in, or replaces, what the neighbour `foreign.next` told of one place. Verified here but for the membership of its switch. Of
    /// several neighbours that tell of one place, the one with the newest statement counts, and of those the nearest; the others' word
    /// is kept for when that takes back its own.
    pub fn set_foreign(&mut self, now: Now, foreign: Foreign) -> Result<(), Refusal> {
        unimplemented!("{now:?} {foreign:?}")
    }

    /// The neighbour takes back what it told of the place.
    pub fn remove_foreign(&mut self, now: Now, place: &RecordPlace, next: &Name) {
        unimplemented!("{now:?} {place:?} {next}")
    }

    /// The neighbour is gone for good, with all that it told.
    pub fn remove_foreign_of(&mut self, now: Now, next: &Name) {
        unimplemented!("{now:?} {next}")
    }

    /// The links into each neighbouring domain are now these, all of them. A domain that is not named here is reached by those to the
    /// neighbour that told of its entities.
    pub fn set_ways(&mut self, now: Now, ways: BTreeMap<Name, Vec<Way>>) {
        unimplemented!("{now:?} {ways:?}")
    }

    /// The places, here and abroad, of which something else is to be told than at the last call. The first call gives all there are.
    pub fn take_changed_places(&mut self) -> BTreeSet<RecordPlace> {
        unimplemented!()
    }

    /// What there is to tell of a place; nothing any more: none.
    pub fn export(&self, now: Now, place: &RecordPlace) -> Option<Export> {
        unimplemented!("{now:?} {place:?}")
    }

    /// The same for all places of a name.
    pub fn exports_of(&self, now: Now, name: &Name) -> impl Iterator<Item = Export> {
        std::iter::from_fn(move || unimplemented!("{now:?} {name}"))
    }
}
