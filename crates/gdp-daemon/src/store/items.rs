//! The items of a RIB in etcd. Each [`Item`] has a key under `PREFIX/item/`. `PREFIX/leader` is the
//! key of the replica that may write them.
//!
//! The leader's key is bound to a lease. Its creation revision identifies the term, and every write
//! compares it. A leader that has lost its lease without noticing therefore changes nothing.

use std::collections::BTreeMap;

use gdp_wire::Name;

use super::StoreError;
use super::client::EtcdClient;
use super::kv::{Compare, KeyValue, Op, WatchEvent};
use gdp_rib::rib::{Item, MAX_ITEM};

/// The maximum size of all keys and values that a replica accepts, in bytes. It is etcd's own
/// default.
pub const MAX_STORED: usize = 2 << 30;

/// The maximum number of operations in one transaction, with as many conditions. etcd's limit is
/// 128, and one condition checks the leader's key.
const MAX_OPS: usize = 127;

/// The maximum size of the items in one transaction, in bytes, unless it has only one item. etcd
/// accepts requests of 1.5 MiB by default; smaller ones get faster answers.
const MAX_TRANSACTION: usize = 256 << 10;

/// The maximum number of attempts of a transaction whose items have changed.
const ATTEMPTS: usize = 4;

/// The location of a RIB in etcd.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeySpace {
    prefix: String,
}

impl KeySpace {
    /// Creates the key space. `prefix` has no slash at its end.
    pub fn new(prefix: &str) -> Self {
        Self { prefix: format!("{prefix}/") }
    }

    /// Returns the prefix of all keys.
    pub fn prefix(&self) -> &[u8] {
        self.prefix.as_bytes()
    }

    pub fn leader(&self) -> Vec<u8> {
        format!("{}leader", self.prefix).into_bytes()
    }

    pub fn key(&self, item: &Item) -> Vec<u8> {
        format!("{}item/{item}", self.prefix).into_bytes()
    }

    fn item(&self, key: &[u8]) -> Option<Item> {
        let rest = key.strip_prefix(self.prefix())?.strip_prefix(b"item/")?;
        std::str::from_utf8(rest).ok()?.parse().ok()
    }

    /// Stands for election. Returns the revision that created the leader's key, if this replica has
    /// that key now.
    pub async fn stand(&self, client: &mut EtcdClient, who: &Name, lease: i64) -> Result<Option<i64>, StoreError> {
        let (key, value) = (self.leader(), who.to_string());
        let put = Op::Put { key: &key, value: value.as_bytes(), lease };
        let outcome = client.transact(&[Compare::Created(&key, 0)], &[put], &[Op::Get(&key)]).await?;
        if outcome.succeeded {
            return Ok(Some(outcome.revision));
        }
        // The answer to an earlier attempt may have been lost.
        let found = outcome.found.into_iter().next().flatten();
        Ok(found.filter(|found| found.lease == lease).map(|found| found.create_revision))
    }

    /// Returns whether there is a leader.
    pub async fn has_leader(&self, client: &mut EtcdClient) -> Result<bool, StoreError> {
        let outcome = client.transact(&[], &[Op::Get(&self.leader())], &[]).await?;
        Ok(outcome.found.iter().any(Option::is_some))
    }
}

/// A follower's copy of the items in etcd, unverified.
#[derive(Debug)]
pub struct Copy {
    keys: KeySpace,
    items: BTreeMap<Item, Stored>,
    size: usize,
    /// The etcd revision up to which the copy is complete.
    revision: i64,
}

#[derive(Debug)]
struct Stored {
    revision: i64,
    value: Vec<u8>,
}

impl Copy {
    pub async fn list(keys: &KeySpace, client: &mut EtcdClient) -> Result<Self, StoreError> {
        let (all, revision) = client.list(keys.prefix(), MAX_STORED).await?;
        let mut copy = Self { keys: keys.clone(), items: BTreeMap::new(), size: 0, revision };
        all.into_iter().for_each(|kv| copy.put(kv));
        Ok(copy)
    }

    pub fn revision(&self) -> i64 {
        self.revision
    }

    /// Applies changes. Returns whether one of them deleted the leader's key.
    pub fn apply(&mut self, events: Vec<WatchEvent>) -> Result<bool, StoreError> {
        let mut leader_gone = false;
        for event in events {
            let (WatchEvent::Put(kv) | WatchEvent::Delete(kv)) = &event;
            self.revision = self.revision.max(kv.mod_revision);
            match event {
                WatchEvent::Put(kv) => self.put(kv),
                WatchEvent::Delete(kv) if kv.key == self.keys.leader() => leader_gone = true,
                WatchEvent::Delete(KeyValue { key, .. }) => {
                    if let Some(old) = self.keys.item(&key).and_then(|item| self.items.remove(&item)) {
                        self.size -= old.value.len();
                    }
                }
            }
        }
        if self.size > MAX_STORED { Err(StoreError::TooMuch(MAX_STORED)) } else { Ok(leader_gone) }
    }

    fn put(&mut self, kv: KeyValue) {
        let Some(item) = self.keys.item(&kv.key) else {
            if kv.key != self.keys.leader() {
                tracing::warn!(key = %String::from_utf8_lossy(&kv.key), "etcd holds under the prefix of the RIB what is none of it");
            }
            return;
        };
        // Reading an oversized item fails, so do not store its value until then.
        let value = if kv.value.len() > MAX_ITEM { Vec::new() } else { kv.value };
        self.size += value.len();
        if let Some(old) = self.items.insert(item, Stored { revision: kv.mod_revision, value }) {
            self.size -= old.value.len();
        }
    }

    /// Returns the items in order.
    pub fn items(&self) -> impl Iterator<Item = (&Item, &[u8])> {
        self.items.iter().map(|(item, stored)| (item, stored.value.as_slice()))
    }

    pub fn get(&self, item: &Item) -> Option<&[u8]> {
        self.items.get(item).map(|stored| stored.value.as_slice())
    }

    /// Converts the copy into the writer of the leader whose key has creation revision `term`.
    pub fn into_writer(self, client: EtcdClient, term: i64) -> ItemWriter {
        let revisions = self.items.into_iter().map(|(item, stored)| (item, stored.revision)).collect();
        ItemWriter { keys: self.keys, client, term, revisions }
    }
}

/// An item and its new value. `None` deletes the item.
pub type ItemChange = (Item, Option<Vec<u8>>);

/// The writer of the leader for one term.
pub struct ItemWriter {
    keys: KeySpace,
    client: EtcdClient,
    term: i64,
    /// The modification revision of each item.
    revisions: BTreeMap<Item, i64>,
}

impl ItemWriter {
    /// Writes or deletes items in as few transactions as possible. Sends at least one, to confirm
    /// that this replica leads. After an error, any of the changes may have been applied.
    pub async fn write(&mut self, changes: &[ItemChange]) -> Result<(), StoreError> {
        let size = |value: &Option<Vec<u8>>| value.as_ref().map_or(0, Vec::len);
        let mut rest = changes;
        loop {
            let mut room = MAX_TRANSACTION;
            let fits = |(_, value): &&ItemChange| {
                let rest = room.checked_sub(size(value));
                room = rest.unwrap_or_default();
                rest.is_some()
            };
            let count = rest.iter().take(MAX_OPS).take_while(fits).count().max(1).min(rest.len());
            let (batch, behind) = rest.split_at(count);
            self.transact(batch).await?;
            rest = behind;
            if rest.is_empty() {
                return Ok(());
            }
        }
    }

    async fn transact(&mut self, batch: &[ItemChange]) -> Result<(), StoreError> {
        let leader = self.keys.leader();
        let keys: Vec<Vec<u8>> = batch.iter().map(|(item, _)| self.keys.key(item)).collect();
        for _ in 0..ATTEMPTS {
            let held = |item| self.revisions.get(item).copied().unwrap_or_default();
            let mut compare = vec![Compare::Created(&leader, self.term)];
            let (mut then, mut otherwise) = (Vec::new(), vec![Op::Get(&leader)]);
            for ((item, value), key) in batch.iter().zip(&keys) {
                compare.push(Compare::Modified(key, held(item)));
                match value {
                    Some(value) => then.push(Op::Put { key, value, lease: 0 }),
                    None => then.push(Op::Delete(key)),
                }
                otherwise.push(Op::Get(key));
            }
            let outcome = self.client.transact(&compare, &then, &otherwise).await?;
            if outcome.succeeded {
                for (item, value) in batch {
                    match value {
                        Some(_) => drop(self.revisions.insert(*item, outcome.revision)),
                        None => drop(self.revisions.remove(item)),
                    }
                }
                return Ok(());
            }
            let mut found = outcome.found.into_iter();
            if found.next().flatten().is_none_or(|found| found.create_revision != self.term) {
                return Err(StoreError::Fenced);
            }
            // The answer to an earlier attempt was lost, or another program writes these keys. The
            // leader's values win.
            for ((item, _), found) in batch.iter().zip(found) {
                match found {
                    Some(found) => drop(self.revisions.insert(*item, found.mod_revision)),
                    None => drop(self.revisions.remove(item)),
                }
            }
        }
        Err(StoreError::Contended)
    }
}
