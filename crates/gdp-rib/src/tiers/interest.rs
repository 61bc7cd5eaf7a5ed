//! Who exchanges messages with whom: what decides which parts a side is told of.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use gdp_proto::control::NameRole;
use gdp_wire::Name;

use super::table::TableRecord;

/// Those on one side who have a part in a name, by their domains: however many they are, a domain
/// is looked at once.
#[derive(Debug, Default)]
pub struct Interest {
    /// Where those who read or call are, by role.
    readers: BTreeMap<NameRole, BTreeSet<Name>>,
    /// By role, and the domain that is in their scope: where those who publish or serve are. Of
    /// more than two domains two are kept, one of which is another than any that is asked for.
    writers: BTreeMap<(NameRole, Name), BTreeSet<Name>>,
}

impl Interest {
    pub fn of<'a>(home: Name, parts: impl Iterator<Item = &'a Arc<TableRecord>>) -> Self {
        let mut interest = Self::default();
        for held in parts {
            let (role, origin) = (held.key.role, held.origin(home));
            if !role.is_writer() {
                interest.readers.entry(role).or_default().insert(origin);
                continue;
            }
            for domain in &held.scope {
                let origins = interest.writers.entry((role, *domain)).or_default();
                if origins.len() < 2 {
                    origins.insert(origin);
                }
            }
        }
        interest
    }

    pub fn is_empty(&self) -> bool {
        self.readers.is_empty() && self.writers.is_empty()
    }

    /// Whether one of them exchanges messages with `other`: in another domain, and in the scope of
    /// whichever of the two writes.
    pub fn wants(&self, other: &TableRecord, home: Name) -> bool {
        let (origin, role) = (other.origin(home), other.key.role.counterpart());
        if role.is_writer() {
            let origins = self.writers.get(&(role, origin));
            origins.is_some_and(|origins| origins.iter().any(|domain| *domain != origin))
        } else {
            let readers = self.readers.get(&role);
            readers
                .is_some_and(|readers| other.scope.iter().any(|domain| *domain != origin && readers.contains(domain)))
        }
    }
}
