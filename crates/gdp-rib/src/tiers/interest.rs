//! Interest of one side in registrations, which decides what the side is told.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use gdp_proto::control::NameRole;
use gdp_wire::Name;

use super::table::TableRecord;

/// Registrations of one side for a name, grouped by domain. Each domain is examined once, however
/// many registrations it has.
#[derive(Debug, Default)]
pub struct Interest {
    /// Domains of readers and callers, by role.
    readers: BTreeMap<NameRole, BTreeSet<Name>>,
    /// Domains of publishers and servers, by role and by domain in their scope. At most two are
    /// stored. Two suffice to find one that differs from any given domain.
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

    /// Returns whether a registration of this side and `other` exchange messages. They must be in
    /// different domains, and the writer's scope must cover the reader's domain.
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
