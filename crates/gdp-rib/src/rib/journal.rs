//! Journal of the items that a store keeps beyond the life of the RIB. It records which items
//! changed since the last query. [`super::restore`] decides what a stored item is worth.

use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

use gdp_proto::control::{NameRole, RecordKey};
use gdp_wire::Name;

/// Key of a stored item, in the order in which a RIB can restore items. Registrations need their
/// switches and attachments, key boxes need their registrations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Item {
    /// Highest serial of all forgotten entities.
    Floor,
    /// Switch that has reported, and its egress bit.
    Switch(Name),
    /// Newest revocation of a name.
    Revocation(Name),
    /// Member admitted by the invitation with this serial.
    Invitation(u64),
    /// Serial floor and attachments of an entity.
    Entity(Name),
    /// Registration of an entity for a name, at one switch.
    Registration(RecordKey),
    /// Key with which `writer` sends to `name`, wrapped for `reader`.
    KeyBox { name: Name, writer: Name, epoch: u32, reader: Name },
}

/// Formats the item as its key in the store: words and hex digits separated by slashes, which
/// people can list.
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

/// Error: the text is not the key of an item.
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
        // Each item has exactly one key.
        if item.to_string() == text { Ok(item) } else { Err(NoItem) }
    }
}

/// Changed items, or `None` if no store follows them.
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

    /// Moves all marked items to `all`.
    pub fn drain(&mut self, all: &mut BTreeSet<Item>) {
        if let Some(changed) = &mut self.0 {
            all.append(changed);
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/rib/journal.rs"]
mod tests;
