//! Replaces the etcd client in a build without the cargo feature `etcd`. It has the same functions,
//! and all of them fail.

use super::kv::{Compare, KeyValue, Op, Outcome, WatchEvent};
use super::{Access, Endpoint, StoreError};

/// The etcd client, which this build does not have.
#[derive(Clone)]
pub struct EtcdClient(());

/// The watch, which this build does not have.
pub struct Watch(());

impl EtcdClient {
    /// Always fails with [`StoreError::NotBuilt`].
    pub fn new(_: &[Endpoint], _: &Access) -> Result<Self, StoreError> {
        Err(StoreError::NotBuilt)
    }

    pub async fn list(&mut self, _: &[u8], _: usize) -> Result<(Vec<KeyValue>, i64), StoreError> {
        Err(StoreError::NotBuilt)
    }

    pub async fn transact(&mut self, _: &[Compare<'_>], _: &[Op<'_>], _: &[Op<'_>]) -> Result<Outcome, StoreError> {
        Err(StoreError::NotBuilt)
    }

    pub async fn grant(&mut self, _: u64) -> Result<i64, StoreError> {
        Err(StoreError::NotBuilt)
    }

    pub async fn keep_alive(&mut self, _: i64) -> Result<bool, StoreError> {
        Err(StoreError::NotBuilt)
    }

    pub async fn revoke(&mut self, _: i64) -> Result<(), StoreError> {
        Err(StoreError::NotBuilt)
    }

    pub async fn watch(&mut self, _: &[u8], _: i64) -> Result<Watch, StoreError> {
        Err(StoreError::NotBuilt)
    }
}

impl Watch {
    pub async fn next(&mut self) -> Result<Vec<WatchEvent>, StoreError> {
        Err(StoreError::NotBuilt)
    }
}
