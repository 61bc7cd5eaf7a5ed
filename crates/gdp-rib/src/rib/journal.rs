//! What of the RIB is to outlive it in a store, item by item: which items have changed since
//! somebody last asked. What an item is worth to a RIB that reads it back is decided in
//! [`super::restore`].

use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

use gdp_proto::control::{NameRole, RecordKey};
use gdp_wire::Name;

/// Something that is stored, by what it is about. In the order in which a RIB can take it back:
/// registrations need the switches and attachments they are bound to, key boxes the registrations
/// they are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Item {
    /// The highest serial of all entities that are forgotten.
    Floor,
    /// A switch that has reported, and its egress bit.
    Switch(Name),
    /// The newest revocation of a name.
    Revocation(Name),
    /// Whom the invitation with this serial has admitted.
    Invitation(u64),
    /// How far the serials of an entity are spent, and where it is attached.
    Entity(Name),
    /// An entity's part in a name, at one switch.
    Registration(RecordKey),
    /// A key of `writer` for what it sends to `name`, wrapped for `reader`.
    KeyBox { name: Name, writer: Name, epoch: u32, reader: Name },
}

/// As the key of the item in a store: words and hex digits between slashes, so that people can list
/// them.
impl fmt::Display for Item {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Floor => f.write_str("floor"),
            Self::Switch(switch) => write!(f, "switch/{switch}"),
            Self::Revocation(name) => write!(f, "revocation/{name}"),
            Self::Invitation(serial) => write!(f, "invitation/{serial}"),
            Self::Entity(entity) => write!(f, "entity/{entity}"),
            Self::Registration(RecordKey { name, role, entity, switch }) => {
                write!(f, "registration/{name}/{role}/{entity}/{switch}")
            }
            Self::KeyBox { name, writer, epoch, reader } => write!(f, "box/{name}/{writer}/{epoch}/{reader}"),
        }
    }
}

/// Not the key of an item.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("not an item that this version knows")]
pub struct NoItem;

impl FromStr for Item {
    type Err = NoItem;

    fn from_str(text: &str) -> Result<Self, NoItem> {
        let parts: Vec<&str> = text.split('/').collect();
        let name = |part: &str| part.parse::<Name>().map_err(|_| NoItem);
        let item = match parts[..] {
            ["floor"] => Self::Floor,
            ["switch", switch] => Self::Switch(name(switch)?),
            ["revocation", of] => Self::Revocation(name(of)?),
            ["invitation", serial] => Self::Invitation(serial.parse().map_err(|_| NoItem)?),
            ["entity", entity] => Self::Entity(name(entity)?),
            ["registration", of, role, entity, switch] => {
                let role = NameRole::ALL.into_iter().find(|known| known.to_string() == role).ok_or(NoItem)?;
                Self::Registration(RecordKey { name: name(of)?, role, entity: name(entity)?, switch: name(switch)? })
            }
            ["box", of, writer, epoch, reader] => {
                let epoch = epoch.parse().map_err(|_| NoItem)?;
                Self::KeyBox { name: name(of)?, writer: name(writer)?, epoch, reader: name(reader)? }
            }
            _ => return Err(NoItem),
        };
        // One item has one key.
        if item.to_string() == text { Ok(item) } else { Err(NoItem) }
    }
}

/// The items that have changed, if anybody wants to know.
#[derive(Debug, Default)]
pub(super) struct Journal(Option<BTreeSet<Item>>);

impl Journal {
    pub fn open(&mut self) {
        self.0 = Some(BTreeSet::new());
    }

    pub fn mark(&mut self, item: Item) {
        if let Some(changed) = &mut self.0 {
            changed.insert(item);
        }
    }

    pub fn is_empty(&self) -> bool {
        self.0.as_ref().is_none_or(BTreeSet::is_empty)
    }

    /// Moves what is marked to `all`.
    pub fn drain(&mut self, all: &mut BTreeSet<Item>) {
        if let Some(changed) = &mut self.0 {
            all.append(changed);
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/rib/journal.rs"]
mod tests;
